"""Greedy episodes: order, refilling of rows, records and scores."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from dockctl.agents.interface import Info, Policy
from dockctl.errors import InputError
from dockctl.evaluation import rollout
from dockctl.evaluation.rollout import TRIED_FIRST, Rollout, evaluation_rows, run_episodes, trajectories_csv
from dockctl.scenarios.loader import load
from dockctl.sim.starts import given_start, own_site
from tests.agents.toy import ToyDocking, starts_at
from tests.evaluation.fixed_policies import Rest
from tests.sim.worlds import walled


class BrakeAtZero(Policy):
    """Drive at 0.1 per step and stop near zero; from 0.4 on, run into the wall."""

    def act(self, observation: np.ndarray, info: Info) -> np.ndarray:
        x, u = observation.T
        wanted = np.where(x > 0.35, 0.3, np.where(np.abs(x) < 0.12, 0.0, 0.1))
        return np.sign((wanted - u).round(3)).astype(int) + 1


@pytest.mark.parametrize("boats", [1, 2, 3, 7])
def test_episodes_do_not_depend_on_the_number_of_boats(boats: int) -> None:
    starts = starts_at(-0.95, 0.45, -0.55, -1.35, 0.4)
    episodes = run_episodes(
        ToyDocking(boats, autoreset=False),
        BrakeAtZero(),
        starts,
        clearance=lambda start, poses: float((0.5 - poses[:, 0]).min()),
    )
    assert [e.outcome for e in episodes] == ["docked", "collision", "docked", "docked", "collision"]
    assert [e.collided_with for e in episodes] == ["", "wall", "", "", "wall"]
    separate = [
        run_episodes(ToyDocking(1, autoreset=False), BrakeAtZero(), starts[i : i + 1])[0]
        for i in range(len(starts))
    ]
    for together, single, start in zip(episodes, separate, starts, strict=True):
        assert together.start is start
        assert together.total_reward == single.total_reward
        for key, values in single.trajectory.items():
            np.testing.assert_array_equal(together.trajectory[key], values)


def test_what_an_episode_records() -> None:
    (episode,) = run_episodes(ToyDocking(1, autoreset=False), BrakeAtZero(), starts_at(-0.35))
    np.testing.assert_allclose(
        episode.trajectory["pose"][:, 0], [-0.35, -0.25, -0.15, -0.05, -0.05], atol=1e-12
    )
    np.testing.assert_allclose(episode.trajectory["command"][:, 0], [0, 0.1, 0, 0, -0.1], atol=1e-12)
    assert episode.steps == 4
    assert episode.path_length_m == pytest.approx(0.3)
    assert episode.control_changes == pytest.approx(2 / 3)
    maneuver = episode.maneuver()
    assert maneuver["contact_speed_mps"] is None
    assert maneuver["propeller_change_n"] == pytest.approx((0.1 + 0 + 0.1) / 3)
    assert maneuver["rudder_change_deg"] == 0
    row = episode.row()
    assert row["clearance_m"] is None
    assert row["distance_m"] == pytest.approx(0.05)
    assert row["return"] == pytest.approx(10 - 0.25 - 0.15 - 0.05)


def test_the_rows_of_a_validation() -> None:
    rows = evaluation_rows(
        run_episodes(ToyDocking(1, autoreset=False), BrakeAtZero(), starts_at(-0.35, 0.45))
    )
    assert [(row["start_kind"], row["pose"], row["outcome"]) for row in rows] == [
        ("pose", 0, "docked"),
        ("pose", 1, "collision"),
    ]


def test_every_row_of_a_trajectory_has_the_outcome_of_its_episode() -> None:
    env = ToyDocking(2, max_steps=5, autoreset=False)
    episodes = run_episodes(env, BrakeAtZero(), starts_at(-0.35, 0.45, -1.35))
    rows = list(csv.DictReader(trajectories_csv(episodes, 0.5).splitlines()))
    outcomes = ("docked", "collision", "timeout")
    expected = [
        outcome for episode, outcome in zip(episodes, outcomes, strict=True) for _ in range(episode.steps + 1)
    ]
    assert [row["outcome"] for row in rows] == expected


@pytest.mark.parametrize(("docks", "played"), [(0, TRIED_FIRST), (7, TRIED_FIRST), (8, 20)])
def test_a_validation_ends_early_where_few_dock(docks: int, played: int) -> None:
    """The first boats start in the berth, the others 16 m away, and all stay there."""
    loaded = load("s1", overrides=["task.max_steps=3"])
    task = Rollout(loaded, [walled()])
    site = own_site(loaded.scenario)
    poses = [site.goals[1] if i < docks else site.initial[0] for i in range(20)]
    starts = [given_start(site, loaded.scenario.task, pose, i) for i, pose in enumerate(poses)]
    episodes = task.validate(Rest(), starts)
    assert [episode.start.index for episode in episodes] == list(range(played))
    assert sum(episode.docked for episode in episodes) == docks


@pytest.mark.parametrize(
    ("conditions", "field"),
    [
        ("{lidar_faults: {sectors: [1, 9]}}", "conditions.lidar_faults.sectors"),
        # three substeps are enough for the vessel's own speeds only
        ("{current: {speed_mps: 10, direction_deg: 90}}", "conditions"),
    ],
)
def test_conditions_that_do_not_match_the_scenario_have_their_place(
    conditions: str, field: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: s1\nvessel: {{substeps: 3}}\nconditions: {conditions}\n")
    loaded = load(file)
    task, site = Rollout(loaded, [walled()]), own_site(loaded.scenario)
    with pytest.raises(InputError) as caught:
        task.run(Rest(), [given_start(site, loaded.scenario.task, site.initial[0], i) for i in range(16)])
    (problem,) = caught.value.problems
    assert (Path(problem.file), problem.line, problem.field) == (file, 3, field)


class FullAhead(Policy):
    def act(self, observation: np.ndarray, info: Info) -> np.ndarray:
        return np.full(len(observation), 73)


def test_conditions_of_an_episode_do_not_depend_on_the_number_of_boats(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    current = "{speed_mps: [0, 0.1], direction_deg: [0, 360]}"
    loaded = load("s1", overrides=[f"conditions.current={current}", "task.max_steps=10"])
    task = loaded.scenario.task
    starts = [given_start(own_site(loaded.scenario), task, np.array([20.0, y, 2.8]), y) for y in range(4)]
    poses = []
    for boats in (1, 3, 16):
        monkeypatch.setattr(rollout, "PARALLEL_BOATS", boats)
        episodes = rollout.Rollout(loaded, [walled()]).run(FullAhead(), starts)
        poses.append(np.array([episode.trajectory["pose"] for episode in episodes]))
    assert np.array_equal(poses[0], poses[1])
    assert np.array_equal(poses[0], poses[2])
    moved = poses[0][:, -1] - poses[0][:, 0]
    assert len(np.unique(moved.round(6), axis=0)) == len(starts)


def test_the_first_seed_of_the_conditions_can_be_chosen() -> None:
    """Episode i from seed 2 has the conditions of episode i + 2 from seed 0, and moves as it does."""
    current = "conditions.current={speed_mps: [0, 0.1], direction_deg: [0, 360]}"
    loads = [
        load("s1", overrides=[current, "task.max_steps=10", f"evaluation.conditions_seed={s}"])
        for s in (0, 2)
    ]
    site, task = own_site(loads[0].scenario), loads[0].scenario.task
    start = given_start(site, task, np.array([20.0, 0.0, 2.8]), 0)
    zero, two = (Rollout(loaded, [walled()]).run(FullAhead(), [start] * 5) for loaded in loads)
    for earlier, later in zip(zero[2:], two, strict=False):
        assert earlier.conditions == later.conditions
        np.testing.assert_array_equal(earlier.trajectory["pose"], later.trajectory["pose"])
    drawn = [tuple(episode.conditions.values()) for episode in zero + two[3:]]
    assert len(set(drawn)) == len(drawn) == 7
