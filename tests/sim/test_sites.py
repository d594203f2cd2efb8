"""A task relocated to many berths: the same maneuver everywhere, in a harbor in which the berth is free."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import strategies as st

from dockctl.errors import InputError
from dockctl.scenarios.harbor import BerthPlace, Marina
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import load
from dockctl.sim.checks import check_poses
from dockctl.sim.starts import StartSampler, free_sites, own_site, sites
from tests.sim.worlds import Wall

S3, MARINA = load("s3").scenario, load("marina").scenario
OPEN = [Wall(math.inf).unreachable] * 5
coordinate, angle = st.floats(-50, 50), st.floats(-math.pi, math.pi)
poses = st.tuples(coordinate, coordinate, angle).map(np.array)


def test_a_task_relocated_to_its_own_berth_is_unchanged_and_mirrored_comes_from_the_other_side() -> None:
    by_name = {site.berth: site for site in sites(MARINA)}
    own = own_site(S3)
    assert by_name["east 0"].initial == pytest.approx(own.initial)
    assert by_name["east 0"].goals == pytest.approx(own.goals)
    mirrored = by_name["east 0 mirrored"]
    assert mirrored.initial == pytest.approx(np.array([[23, 10, -math.pi / 2]]))
    assert mirrored.goals == pytest.approx(np.array([[18, -3, math.radians(-150)], [36, 0, math.pi]]))
    # half a turn about the midpoint between the berths maps the east berth to the west one
    assert by_name["west -2"].initial == pytest.approx(np.array([[20, 8, -math.pi / 2]]))
    assert by_name["west -2"].goals[1] == pytest.approx([7, -2, 0])


def test_each_berth_is_free_in_its_harbor_and_the_others_are_occupied_or_of_the_same_group() -> None:
    assert MARINA.task.berths is not None
    free_somewhere: list[BerthPlace] = []
    for layout in layouts(MARINA.harbor, MARINA.task.berths):
        assert isinstance(layout.harbor, Marina)
        free = {BerthPlace(row.side, at) for row in layout.harbor.rows for at in row.free}
        assert free == set(layout.berths)
        assert 0 < len(free) <= MARINA.task.berths.vacant
        free_somewhere += layout.berths
    assert isinstance(MARINA.harbor, Marina)
    every = {BerthPlace(row.side, at) for row in MARINA.harbor.rows for at in row.berths}
    assert sorted(free_somewhere) == sorted(every)


def test_held_out_berths_are_never_a_goal_of_training() -> None:
    assert MARINA.task.berths is not None
    held_out = {site.berth for site in sites(MARINA) if site.kind == "held_out"}
    trained = [site for site in sites(MARINA) if site.kind == "trained"]
    assert len(held_out) >= len(sites(MARINA)) / 3
    sampler, rng = StartSampler(MARINA, trained, OPEN, exploring=True), np.random.default_rng(0)
    drawn = [sampler.draw(rng) for _ in range(600)]
    assert not {start.berth for start in drawn} & held_out
    assert {start.berth for start in drawn} == {site.berth for site in trained}
    harbors = {site.berth: site.harbor for site in trained}
    assert all(start.harbor == harbors[start.berth] for start in drawn)


def test_blocked_sites_are_skipped() -> None:
    """An obstacle north of y = 24 m leaves space only south of the berth at 18 m."""
    free = {site.berth for site in free_sites(MARINA, [lambda eta, goal: eta[:, 1] > 24] * 5)}
    assert {"east 13", "east 13 mirrored", "east 18"} <= free
    assert not {"east 18 mirrored", "east 27", "east 27 mirrored"} & free
    assert len(free_sites(MARINA, OPEN)) == len(sites(MARINA))
    assert free_sites(S3, [Wall(-1e9).unreachable])[0].berth == ""


@pytest.mark.parametrize("kind", ["trained", "held_out"])
def test_at_least_one_berth_of_each_kind_must_be_free(kind: str) -> None:
    harbors = [layout.kind for layout in layouts(MARINA.harbor, MARINA.task.berths)]
    blocked = [Wall(-1e9 if of == kind else math.inf).unreachable for of in harbors]
    with pytest.raises(InputError) as refusal:
        free_sites(MARINA, blocked)
    assert [problem.field for problem in refusal.value.problems] == [f"task.berths.{kind}"]


def test_blocked_berths_are_a_problem_of_the_scenario() -> None:
    """Ten meters south of the southernmost berth is the quay."""
    crowded = load(
        "marina",
        overrides=[
            "task.initial.0.y_m=10",
            "task.berths.trained={east: [0], west: []}",
            "task.berths.held_out={east: [], west: [-33]}",
            "task.berths.mirrored=false",
        ],
    )
    problems = check_poses(crowded.scenario, crowded.base_dir).problems
    assert [field for field, _ in problems] == ["task.berths.held_out"]


@pytest.mark.parametrize("heading_deg", [180, -180, 540])
def test_the_own_berth_is_found_for_equivalent_headings(heading_deg: float) -> None:
    """The berth is held out, and so is not free in the first harbor."""
    turned = load("marina", overrides=[f"task.final.heading_deg={heading_deg}"])
    own = own_site(turned.scenario)
    assert own.harbor == next(site.harbor for site in sites(MARINA) if site.berth == "east 0") > 0


def test_a_final_pose_must_be_in_a_berth() -> None:
    assert own_site(load("marina", overrides=["task.final.x_m=35.9"]).scenario).goals[1][0] == 35.9
    off = load("marina", overrides=["task.final.y_m=0.1"])
    ((field, message),) = check_poses(off.scenario, off.base_dir).problems
    assert field == "task.final"
    assert "(36, 0, 180°)" in message  # the nearest berth
    with pytest.raises(InputError, match=r"task\.final"):
        own_site(off.scenario)


@pytest.mark.parametrize(
    ("berths", "field", "code"),
    [
        ("held_out: {east: [1]}", "held_out.east.0", "mismatch"),
        ("held_out: {north: [1]}", "held_out.north.0", "mismatch"),
        ("held_out: {east: [0, 4]}", "held_out.east.1", "duplicate"),
        ("trained: {east: [], west: []}", "trained", "missing_key"),
    ],
)
def test_invalid_berths_are_rejected_in_their_place(
    berths: str, field: str, code: str, tmp_path: Path
) -> None:
    (tmp_path / "mine.yaml").write_text(f"extends: marina\ntask:\n  berths:\n    {berths}\n")
    with pytest.raises(InputError) as caught:
        load(tmp_path / "mine.yaml")
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (4, f"task.berths.{field}", code)


def test_the_intermediate_pose_is_drawn_in_training() -> None:
    pose = MARINA.task.intermediate
    assert pose is not None and pose.position_offset_m > 0
    reach = [
        pose.position_offset_m,
        pose.position_offset_m,
        math.radians(pose.heading_offset_deg),
    ]
    nominal = {site.berth: site.goals for site in sites(MARINA)}
    sampler, rng = StartSampler(MARINA, sites(MARINA), OPEN), np.random.default_rng(2)
    offsets = []
    for _ in range(200):
        start = sampler.draw(rng)
        assert np.array_equal(start.goals[1], nominal[start.berth][1])
        offsets.append(start.goals[0] - nominal[start.berth][0])
    assert (np.abs(offsets) <= reach).all()
    assert (np.ptp(offsets, axis=0) > np.array(reach)).all()
