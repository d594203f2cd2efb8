"""Faulty sectors, with a sensor whose ranges change in every step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, InputError
from dockctl.experiments.dry_run import dry_run
from dockctl.scenarios.loader import load
from tests.sim.worlds import walled

AHEAD = 73
"""The action of full thrust with the rudder amidships."""
RANGE_M = 100.0


def ranges(fault: str | None, *changes: str, boats: int = 2, steps: int = 6) -> tuple[Any, Any]:
    """Sector ranges (steps + 1, boats, 8) while the boats drive ahead, and the pose."""
    overrides = [f"conditions.lidar_faults={fault}"] if fault else []
    env = DockingVectorEnv(load("s1", overrides=[*overrides, *changes]), boats, worlds=[walled()])
    _, info = env.reset(seed=0)
    scans, poses = [info["sector_ranges_m"]], [info["pose"]]
    for _ in range(steps):
        _, _, _, _, info = env.step(np.full(boats, AHEAD))
        scans.append(info["sector_ranges_m"])
        poses.append(info["pose"])
    return np.array(scans), np.array(poses)


@pytest.mark.parametrize(("mode", "reads"), [("blind", RANGE_M), ("occluded", 0.5)])
def test_faulty_sectors_read_a_constant_and_the_others_what_they_see(mode: str, reads: float) -> None:
    true, poses = ranges(None)
    faulty, same_poses = ranges(f"{{sectors: [1, 8], mode: {mode}}}")
    assert np.array_equal(poses, same_poses)
    assert (faulty[..., [0, 7]] == reads).all()
    assert np.array_equal(faulty[..., 1:7], true[..., 1:7])


def test_a_frozen_sector_reads_its_first_value_after_the_fault() -> None:
    """At 1.5 s, three steps after the start, its value freezes."""
    true, _ = ranges(None)
    assert (np.diff(true[..., 2], axis=0) != 0).all()
    faulty, _ = ranges("{sectors: [3], mode: frozen, after_s: 1.5}")
    assert np.array_equal(faulty[:4], true[:4])
    assert (faulty[3:, :, 2] == true[3, :, 2]).all()
    assert np.array_equal(np.delete(faulty, 2, axis=2), np.delete(true, 2, axis=2))


def test_a_fault_begins_at_its_time_also_where_the_periods_do_not_add_up_exactly() -> None:
    """Eight times 0.1 is less than 0.8 in floating point."""
    faulty, _ = ranges("{sectors: [3], after_s: 0.8}", "vessel.control_period_s=0.1", boats=1, steps=9)
    assert (faulty[:, 0, 2] == RANGE_M).tolist() == [False] * 8 + [True] * 2


def test_a_frozen_sector_is_released_by_a_reset() -> None:
    loaded = load("s1", overrides=["conditions.lidar_faults={sectors: [3], mode: frozen}"])
    env = DockingVectorEnv(loaded, 2, worlds=[walled()])
    env.reset(seed=0)
    first = env.reset(options={"poses": [[10, 5, 0], [10, 5, 0]]})[1]["sector_ranges_m"]
    mask = np.array([False, True])
    second = env.reset(options={"poses": [[20, 5, 0]] * 2, "reset_mask": mask})[1]["sector_ranges_m"]
    assert second[0, 2] == first[0, 2]
    assert second[1, 2] != first[1, 2]


def test_a_sector_that_does_not_exist_is_refused() -> None:
    with pytest.raises(DockctlError) as caught:
        ranges("{sectors: [9]}")
    assert caught.value.code == "out_of_range"


@pytest.mark.parametrize(
    ("conditions", "field", "column"),
    [
        ("{lidar_faults: {sectors: [1, 9]}}", "conditions.lidar_faults.sectors", 38),
        ("{algae: {kind: lidar_faults, sectors: [9]}}", "conditions.algae.sectors", 51),
        (
            "{lidar_faults: {sectors: [1], mode: occluded, occluded_m: 101}}",
            "conditions.lidar_faults.occluded_m",
            71,
        ),
    ],
)
def test_what_the_sensor_cannot_read_has_its_place(
    conditions: str, field: str, column: int, tmp_path: Path
) -> None:
    """The sensor has 8 sectors and reads up to 100 m."""
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: s1\nconditions: {conditions}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(file))
    (problem,) = caught.value.problems
    assert (problem.field, problem.line, problem.column) == (field, 2, column)
    assert problem.code == "out_of_range"


def test_only_an_occluded_sector_needs_a_range_that_the_sensor_reads() -> None:
    faulty, _ = ranges("{sectors: [1], mode: blind, occluded_m: 101}")
    assert (faulty[..., 0] == RANGE_M).all()


def test_a_sector_fails_only_once() -> None:
    with pytest.raises(InputError) as caught:
        load("s1", overrides=["conditions.lidar_faults={sectors: [2, 1, 2]}"])
    (problem,) = caught.value.problems
    assert problem.code == "duplicate"
    assert "sectors.2" in str(problem)
