"""Starts of episodes: within their bounds, free of obstacles, reproducible."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from dockctl.errors import DockctlError, InputError
from dockctl.geometry import Floats
from dockctl.scenarios.harbor import Marina
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.training import Training
from dockctl.sim.checks import load_checked, notes
from dockctl.sim.starts import (
    Start,
    StartSampler,
    exploring_start,
    free_sites,
    given_start,
    own_site,
    rejected_shares,
)
from dockctl.sim.world import build_worlds
from tests.sim.worlds import Wall

S1, S2, S3 = (load(name).scenario for name in ("s1", "s2", "s3"))
seeds = st.integers(0, 10_000)


def with_offsets(scenario: Scenario, position_m: float, heading_deg: float) -> Scenario:
    moved = {"position_offset_m": position_m, "heading_offset_deg": heading_deg}
    initial = tuple(pose.model_copy(update=moved) for pose in scenario.task.initial)
    return scenario.model_copy(update={"task": scenario.task.model_copy(update={"initial": initial})})


def draw_exploring(scenario: Scenario, seed: int, wall: float = math.inf) -> Start:
    exploring = scenario.training.exploring_starts
    assert exploring is not None
    site, rng = own_site(scenario), np.random.default_rng(seed)
    return exploring_start(site, scenario.task, exploring, rng, Wall(wall).unreachable)


def sampler_of(scenario: Scenario, wall: float = math.inf, *, exploring: bool = False) -> StartSampler:
    return StartSampler(scenario, [own_site(scenario)], [Wall(wall).unreachable], exploring=exploring)


def test_poses_without_offset_are_exact_and_all_are_drawn() -> None:
    sampler, rng = sampler_of(S2), np.random.default_rng(0)
    starts = [sampler.draw(rng) for _ in range(60)]
    assert {start.index for start in starts} == {0, 1, 2}
    for start in starts:
        pose = S2.task.initial[start.index]
        assert start.eta.tolist() == [pose.x_m, pose.y_m, math.radians(pose.heading_deg)]
        assert (start.kind, start.phase, start.max_steps) == ("pose", 1, S2.task.max_steps)
        assert not start.nu.any()


def test_phase_and_goals_with_and_without_an_intermediate_pose() -> None:
    pose = np.array([23.0, -10.0, 1.5])
    in_two_phases = given_start(own_site(S3), S3.task, pose, 4)
    assert (in_two_phases.phase, in_two_phases.index) == (0, 4)
    assert in_two_phases.goals == pytest.approx(np.array([[18, 3, math.radians(150)], [36, 0, math.pi]]))
    in_one = given_start(own_site(S1), S1.task, pose, 0)
    assert in_one.phase == 1
    assert in_one.goals == pytest.approx(np.array([[36, 0, math.pi]] * 2))


@given(seed=seeds)
def test_offsets_are_within_their_bounds_and_free(seed: int) -> None:
    scenario = with_offsets(S1, 3.0, 15.0)
    start = sampler_of(scenario, 21.0).draw(np.random.default_rng(seed))
    off = np.abs(start.eta - [20, 2, math.radians(160)])
    assert (off <= [3, 3, math.radians(15)]).all()
    assert start.eta[0] <= 21


def test_if_everything_is_unreachable_there_is_an_error() -> None:
    with pytest.raises(DockctlError):
        sampler_of(with_offsets(S1, 3.0, 15.0), -1e9).draw(np.random.default_rng(0))
    with pytest.raises(DockctlError):
        draw_exploring(S1, 0, wall=-1e9)


@pytest.mark.parametrize("name", ["s3", pytest.param("marina", marks=pytest.mark.slow)])
def test_starts_with_a_wide_spread_are_all_in_the_basin(name: str) -> None:
    """Half the square of +-40 m is behind the quays of the basin."""
    scenario = with_offsets(load(name).scenario, 40.0, 180.0)
    unreachable = [world.obstacles.unreachable for world in build_worlds(scenario, Path())]
    every = free_sites(scenario, unreachable)
    sampler, rng = StartSampler(scenario, every, unreachable), np.random.default_rng(0)
    starts = [sampler.draw(rng) for _ in range(60)]
    assert isinstance(scenario.harbor, Marina)
    basin = scenario.harbor.basin
    for start in starts:
        assert basin.x_min_m < start.eta[0] < basin.x_max_m
        assert basin.y_min_m < start.eta[1] < basin.y_max_m
    share = sum(start.rejected for start in starts) / (60 + sum(start.rejected for start in starts))
    assert rejected_shares(scenario, unreachable, every)["task.initial.0"] == pytest.approx(share, abs=0.12)
    assert share > 0.5


@pytest.mark.parametrize("fraction", [0.0, 0.3, 1.0])
def test_close_starts_are_as_frequent_as_their_fraction(fraction: float) -> None:
    """Starts are uniform in 17 m < x < 23 m, of which the last meter is close."""
    training = Training(close_starts={"fraction": fraction, "within_m": 1.0}, exploring_starts=None)
    scenario = with_offsets(S1, 3.0, 15.0).model_copy(update={"training": training})

    def near(start: Start, within_m: float) -> bool:
        return bool(start.eta[0] > 23 - within_m)

    sites, open_water, rng = [own_site(scenario)], [Wall(math.inf).unreachable], np.random.default_rng(0)
    sampler = StartSampler(scenario, sites, open_water, near, exploring=True)
    close = np.mean([near(sampler.draw(rng), 1.0) for _ in range(2000)])
    assert close == pytest.approx(fraction + (1 - fraction) / 6, abs=0.03)
    evaluated = StartSampler(scenario, sites, open_water, near)
    assert np.mean([near(evaluated.draw(rng), 1.0) for _ in range(2000)]) == pytest.approx(1 / 6, abs=0.03)


def test_where_nothing_is_close_a_start_is_drawn_nevertheless() -> None:
    training = Training(close_starts={"fraction": 1.0}, exploring_starts=None)
    scenario = with_offsets(S1, 3.0, 15.0).model_copy(update={"training": training})
    open_water = [Wall(math.inf).unreachable]
    sampler = StartSampler(scenario, [own_site(scenario)], open_water, exploring=True)
    assert sampler.draw(np.random.default_rng(0)).kind == "pose"


def test_rejected_draws_are_counted() -> None:
    """The wall at 21 m leaves two thirds of the starts around x = 20 m."""
    sampler, rng = sampler_of(with_offsets(S1, 3.0, 15.0), 21.0), np.random.default_rng(0)
    rejected = sum(sampler.draw(rng).rejected for _ in range(600))
    assert rejected / (600 + rejected) == pytest.approx(1 / 3, abs=0.05)
    open_water, rng = sampler_of(with_offsets(S1, 3.0, 15.0)), np.random.default_rng(0)
    assert not any(open_water.draw(rng).rejected for _ in range(50))


@pytest.mark.parametrize(
    ("change", "line", "field"),
    [
        (
            "task: {initial: [{x_m: 20, y_m: 2, heading_deg: 160, position_offset_m: 5000}]}",
            2,
            "task.initial.0",
        ),
        ("training: {exploring_starts: {position_noise_m: [900, 900]}}", 2, "training.exploring_starts"),
        ("evaluation: {random_starts: {position_m: 900}}", 2, "evaluation.random_starts"),
    ],
)
def test_a_spread_that_hardly_ever_hits_water_is_a_problem_of_the_scenario(
    change: str, line: int, field: str, tmp_path: Path
) -> None:
    (tmp_path / "wide.yaml").write_text(f"extends: s1\n{change}\n")
    with pytest.raises(InputError) as caught:
        load_checked(tmp_path / "wide.yaml")
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (line, field)


def test_poses_in_separate_waters_are_a_problem_of_the_scenario(tmp_path: Path) -> None:
    """A wall from quay to quay, between the start at x = 20 m and the berth at 36 m."""
    wall = trimesh.creation.box(bounds=[(27.0, -45.0, -1.0), (27.2, 45.0, 1.0)])
    wall.export(tmp_path / "wall.obj")
    (tmp_path / "divided.yaml").write_text(
        "extends: s1\nharbor:\n  meshes: [{path: wall.obj}]\n"
        "task: {initial: [{x_m: 20, y_m: 2, heading_deg: 160}]}\n"
    )
    with pytest.raises(InputError) as caught:
        load_checked(tmp_path / "divided.yaml")
    assert ("task.initial.0", 4) in {(problem.field, problem.line) for problem in caught.value.problems}


def test_a_wide_spread_is_noted(tmp_path: Path) -> None:
    (tmp_path / "wide.yaml").write_text("extends: s1\nevaluation: {random_starts: {position_m: 40}}\n")
    (note,) = notes(load_checked(tmp_path / "wide.yaml"))
    assert note.startswith("evaluation.random_starts")
    assert not notes(load_checked("marina"))


def test_berths_with_a_blocked_pose_on_both_sides_are_noted(tmp_path: Path) -> None:
    """18 m south of the berths below the T-head, at y = -19 m, is the quay, at -34 m."""
    far = "  intermediate: {x_m: 18, y_m: 4, heading_deg: 150}"
    (tmp_path / "far.yaml").write_text(f"extends: marina-t-head\ntask:\n{far}\n")
    trained, held_out = notes(load_checked(tmp_path / "far.yaml"))
    assert "task.berths.trained" in trained
    assert "north 7.4" in trained
    assert "task.berths.held_out" in held_out
    assert all(f"north {at}" in held_out for at in ("-5", "11.3", "-12.8"))
    assert not notes(load_checked("marina-t-head"))


@given(seed=seeds)
def test_exploring_starts_are_near_their_leg(seed: int) -> None:
    start = draw_exploring(S3, seed)
    initial = np.array([23, -10, math.pi / 2])
    intermediate, final = start.goals
    begin, end = (initial, intermediate) if start.phase == 0 else (intermediate, final)
    along = np.clip(
        (start.eta - begin)[:2] @ (end - begin)[:2] / ((end - begin)[:2] @ (end - begin)[:2]), 0, 1
    )
    nearest = begin + along * (end - begin)
    assert (np.abs((start.eta - nearest)[:2]) <= 2.3 * math.sqrt(2)).all()
    low, high = sorted((begin[2], end[2]))
    assert low - math.radians(26) <= start.eta[2] <= high + math.radians(26)
    assert abs(start.nu[0]) <= 0.35
    assert not start.nu[1:].any()
    assert (start.kind, start.max_steps) == ("exploring", 300)


def test_exploring_starts_cover_both_legs_their_length_and_both_directions() -> None:
    starts = [draw_exploring(S3, seed) for seed in range(400)]
    phases = np.array([start.phase for start in starts])
    assert 140 < phases.sum() < 260
    x = np.array([start.eta[0] for start in starts])[phases == 1]
    assert np.histogram(x, bins=3, range=(18, 36))[0].min() > 40
    surge = np.array([start.nu[0] for start in starts])
    assert surge.min() < -0.3
    assert surge.max() > 0.3


def test_headings_turn_by_the_smaller_angle() -> None:
    """From -170 to 170 degrees through 180, not through 0."""
    turned = S1.task.initial[0].model_copy(update={"heading_deg": -170.0})
    final = S1.task.final.model_copy(update={"heading_deg": 170.0})
    task = S1.task.model_copy(update={"initial": (turned,), "final": final})
    scenario = S1.model_copy(update={"task": task})
    headings = np.degrees([draw_exploring(scenario, seed).eta[2] for seed in range(200)])
    assert (np.cos(np.radians(headings)) < math.cos(math.radians(180 - 10 - 26)) + 1e-12).all()


@given(seed=seeds)
def test_exploring_starts_avoid_obstacles(seed: int) -> None:
    assert draw_exploring(S3, seed, wall=30.0).eta[0] <= 30


def test_the_fraction_of_exploring_starts_is_that_of_the_scenario() -> None:
    rng = np.random.default_rng(1)
    kinds = [sampler_of(S3, exploring=True).draw(rng).kind for _ in range(400)]
    assert 160 < kinds.count("exploring") < 240
    plain = sampler_of(S3)
    assert {plain.draw(rng).kind for _ in range(50)} == {"pose"}


def test_the_same_seed_draws_the_same_starts() -> None:
    def draw() -> Floats:
        rng = np.random.default_rng(7)
        return np.stack([sampler_of(S3, exploring=True).draw(rng).eta for _ in range(20)])

    assert np.array_equal(draw(), draw())
