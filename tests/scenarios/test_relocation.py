"""The key ``berth``: the poses of a scenario at another berth of its marina."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from dockctl.errors import InputError
from dockctl.scenarios import loader
from dockctl.scenarios.base import Pose
from dockctl.scenarios.harbor import Marina
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.settings import settings
from dockctl.sim.checks import check_poses
from dockctl.sim.starts import sites


def load(folder: Path, text: str) -> loader.LoadedScenario:
    path = folder / "mine.yaml"
    path.write_text(text)
    return loader.load(path)


def poses(scenario: Scenario) -> list[Pose]:
    task = scenario.task
    middle = [task.intermediate] if task.intermediate else []
    return [*task.initial, *middle, *scenario.evaluation.poses]


def from_berth(scenario: Scenario) -> list[tuple[float, float, float]]:
    """Return distance [m], bearing and heading [°] of each pose, seen from the final pose."""
    final = scenario.task.final
    return [
        (
            math.hypot(pose.x_m - final.x_m, pose.y_m - final.y_m),
            (math.degrees(math.atan2(pose.y_m - final.y_m, pose.x_m - final.x_m)) - final.heading_deg) % 360,
            (pose.heading_deg - final.heading_deg) % 360,
        )
        for pose in poses(scenario)
    ]


@pytest.mark.parametrize("name", ["s2", "s3"])
def test_the_poses_are_the_same_seen_from_the_berth(tmp_path: Path, name: str) -> None:
    base = loader.load(name).scenario
    scenario = load(tmp_path, f"extends: {name}\nberth: west 12\n").scenario
    final = scenario.task.final
    # the west quay is at x = 4.5 m, and a boat docks 2.5 m off it, as in the berth east 0: 38.5 - 36
    assert (final.x_m, final.y_m, final.heading_deg) == (7.0, 12.0, 0.0)
    for moved, pose in zip(from_berth(scenario), from_berth(base), strict=True):
        assert moved == pytest.approx(pose, abs=1e-6)
    assert isinstance(scenario.harbor, Marina)
    assert [row.free for row in scenario.harbor.rows] == [(0.0,), (-2.0, 12.0)]
    (tmp_path / "dumped.yaml").write_text(loader.dump(scenario))
    assert loader.load(tmp_path / "dumped.yaml").scenario == scenario


def test_at_its_own_berth_a_scenario_is_the_same() -> None:
    assert loader.load("s3", overrides=["berth=east 0"]).scenario == loader.load("s3").scenario


def test_null_removes_an_inherited_berth(tmp_path: Path) -> None:
    (tmp_path / "base.yaml").write_text("extends: s1\nberth: west 12\n")
    assert load(tmp_path, "extends: base.yaml\n").scenario.task.final.x_m == 7.0
    unmoved = load(tmp_path, "extends: base.yaml\nberth: null\n").scenario
    assert unmoved.task == loader.load("s1").scenario.task


def test_an_unknown_berth_is_an_error_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, "extends: s1\nberth: west 13\n")
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (2, "berth", "unknown_name")
    assert problem.suggestion == "west 12"
    assert "east -27" in problem.message
    assert "west 25" in problem.message


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("extends: s1\nberth: 12\n", "wrong_type"),
        ("extends: s1\nberth: up 12\n", "wrong_type"),
        ("extends: s1\nberth: {west: 12}\n", "wrong_type"),
        ("extends: marina\nberth: west 12\n", "mismatch"),
        ("extends: s1\nharbor: {kind: generated}\nberth: west 12\n", "mismatch"),
    ],
)
def test_what_is_no_berth(tmp_path: Path, text: str, code: str) -> None:
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    (problem,) = caught.value.problems
    assert (problem.field, problem.code) == ("berth", code)


def test_moved_values_come_from_the_line_of_the_berth(tmp_path: Path) -> None:
    listed = {setting.field: setting for setting in settings(load(tmp_path, "extends: s1\nberth: west 12\n"))}
    for field in ("task.initial.0.heading_deg", "task.final.x_m", "harbor.rows.1.free_y_m"):
        location = listed[field].location
        assert location
        assert location.line == 2
        assert location.file.endswith("mine.yaml")


@pytest.mark.parametrize(
    ("length_m", "final", "x_m"),
    [
        (4, "{x_m: 36}", 4.5 + 2.5),  # as far off the quay as in its own berth, east 0: 38.5 - 36
        (6, "{x_m: 34.5}", 4.5 + 4),
        (6, "{x_m: 30, y_m: 1}", 4.5 + 3 + 1),  # at no berth: the stern 1 m off the quay
        (1.5, "{x_m: 30, heading_deg: 170}", 4.5 + 0.75 + 1),
    ],
)
def test_a_boat_docks_as_far_off_the_quay_as_in_its_berth(length_m: float, final: str, x_m: float) -> None:
    """The quays of the reference harbor are at x = 4.5 and 38.5 m."""
    overrides = [f"vessel.hull.length_m={length_m}", f"task.final={final}", "berth=west 12"]
    assert loader.load("s3", overrides=overrides).scenario.task.final.x_m == pytest.approx(x_m)


@pytest.mark.parametrize(("x_m", "problem"), [(34.5, ""), (36, "blocked by the east quay")])
def test_a_boat_of_six_meters_docks_in_generated_layouts(x_m: float, problem: str) -> None:
    overrides = [
        "vessel.hull={length_m: 6, beam_m: 2.2}",
        "harbor={kind: generated, layouts: 2, held_out_layouts: 1}",
        "harbor={berth_width_m: [4, 5], fairway_m: [20, 30]}",
        "task.berths={}",
        f"task.final={{x_m: {x_m}, y_m: 0, heading_deg: 180}}",
    ]
    loaded = loader.load("s3", overrides=overrides)
    found = check_poses(loaded.scenario, loaded.base_dir).problems
    assert len(found) == bool(problem) and all(problem in message for _, message in found)
    final = {tuple(site.goals[1][:1]) for site in sites(loaded.scenario) if "east" in site.berth}
    assert (x_m,) in final


@pytest.mark.parametrize("length_m", [2, 4])
def test_berths_suit_boats_of_other_lengths(length_m: float) -> None:
    loaded = loader.load("marina", overrides=[f"vessel.hull.length_m={length_m}"])
    assert not check_poses(loaded.scenario, loaded.base_dir).problems
