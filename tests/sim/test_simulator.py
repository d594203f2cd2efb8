"""A control step: what it changes, in which order, and for which boats."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from dockctl.errors import DockctlError
from dockctl.scenarios.loader import load
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, given_start, own_site
from dockctl.sim.vessel import VesselModel
from tests.sim.worlds import Rings, walled

S1, S3 = load("s1").scenario, load("s3").scenario
IDLE = np.zeros((1, 2))


def start_at(x: float, y: float, heading_deg: float, *, phase: int = 0, surge: float = 0.0) -> Start:
    start = given_start(own_site(S3), S3.task, np.array([x, y, math.radians(heading_deg)]), 0)
    return replace(start, phase=phase, nu=np.array([surge, 0.0, 0.0]))


def simulator(*starts: Start, wall: float = math.inf) -> Simulator:
    sim = Simulator(S3, [walled(wall)], len(starts))
    sim.reset(np.arange(len(starts)), starts)
    return sim


def test_a_step_integrates_the_vessel_and_scans_from_the_new_pose() -> None:
    sim, command = simulator(start_at(23, -10, 90)), np.array([[50.0, 0.2]])
    eta, nu = VesselModel(S3.vessel).step(sim.eta, sim.nu, command)
    status = sim.step(command)
    assert np.array_equal(sim.eta, eta)
    assert np.array_equal(status.nu, nu)
    assert np.array_equal(status.sector_ranges_m, Rings().sector_ranges(eta))
    assert status.distance_m == pytest.approx(np.hypot(*(eta - sim.goals[:, 0])[0, :2]))
    assert status.previous_distance_m == pytest.approx([math.hypot(5, 13)])
    assert status.previous_heading_error_rad == pytest.approx([math.radians(-60)])
    assert status.command.tolist() == [[50.0, 0.2]]
    assert status.previous_command.tolist() == [[0.0, 0.0]]
    assert sim.step(IDLE).previous_command.tolist() == [[50.0, 0.2]]


def test_after_the_intermediate_pose_the_goal_is_the_final_pose() -> None:
    sim = simulator(start_at(18, 3, 150))
    status = sim.step(IDLE)
    assert status.reached_intermediate.tolist() == [True]
    assert status.reached_final.tolist() == [False]
    assert status.phase.tolist() == [0]
    assert status.distance_m == pytest.approx([0])
    assert sim.phase.tolist() == [1]
    assert sim.distance_m == pytest.approx([math.hypot(18, 3)])
    after = sim.step(IDLE)
    assert after.phase.tolist() == [1]
    assert after.previous_distance_m == pytest.approx([math.hypot(18, 3)])
    assert not after.reached_intermediate.any()


def test_the_final_pose_is_reached_in_the_second_phase_only() -> None:
    sim = simulator(start_at(36, 0, 180), start_at(36, 0, 180, phase=1))
    assert sim.step(np.zeros((2, 2))).reached_final.tolist() == [False, True]


def test_a_boat_above_the_speed_tolerance_has_not_reached_the_pose() -> None:
    sim = simulator(start_at(36, 0, 180, phase=1, surge=0.3), start_at(36, 0, 180, phase=1, surge=0.11))
    assert sim.step(np.zeros((2, 2))).reached_final.tolist() == [False, True]


def test_a_collision_takes_precedence_over_poses_reached_in_the_same_step() -> None:
    sim = simulator(start_at(18, 3, 150), start_at(36, 0, 180, phase=1), wall=17.0)
    status = sim.step(np.zeros((2, 2)))
    assert status.collided.tolist() == [True, True]
    assert not (status.reached_intermediate | status.reached_final).any()
    assert sim.phase.tolist() == [0, 1]


def test_reset_changes_its_rows_only() -> None:
    sim = simulator(start_at(23, -10, 90), start_at(23, -10, 90), start_at(23, -10, 90))
    for _ in range(3):
        sim.step(np.tile([50.0, 0.1], (3, 1)))
    before = sim.eta.copy(), sim.nu.copy(), sim.sector_ranges_m.copy()
    sim.reset(np.array([1]), [start_at(30, 1, 170, phase=1)])
    assert sim.steps.tolist() == [3, 0, 3]
    assert sim.phase.tolist() == [0, 1, 0]
    assert sim.command.tolist() == [[50.0, 0.1], [0.0, 0.0], [50.0, 0.1]]
    assert not sim.nu[1].any()
    assert sim.distance_m[1] == pytest.approx(math.hypot(6, 1))
    for old, now in zip(before, (sim.eta, sim.nu, sim.sector_ranges_m), strict=True):
        assert np.array_equal(old[[0, 2]], now[[0, 2]])


def test_a_reset_scans_its_rows_only() -> None:
    sim = simulator(*[start_at(23, -10, 90)] * 5)
    lidar = sim.worlds[0].lidar
    assert isinstance(lidar, Rings)
    lidar.scanned = 0
    sim.reset(np.array([2]), [start_at(20, 0, 0)])
    assert lidar.scanned == 1


def test_a_status_does_not_change_in_later_steps() -> None:
    sim = simulator(start_at(23, -10, 90))
    status = sim.step(np.array([[50.0, 0.1]]))
    copies = status.nu.copy(), status.sector_ranges_m.copy(), status.distance_m.copy(), status.phase.copy()
    sim.reset(np.array([0]), [start_at(30, 1, 170, phase=1)])
    sim.step(IDLE)
    now = status.nu, status.sector_ranges_m, status.distance_m, status.phase
    assert all(np.array_equal(a, b) for a, b in zip(copies, now, strict=True))


def test_a_reward_that_writes_into_the_status_does_not_move_the_boat() -> None:
    sim, same = (simulator(start_at(23, -10, 90)) for _ in range(2))
    for _ in range(2):
        status, _ = sim.step(np.array([[50.0, 0.1]])), same.step(np.array([[50.0, 0.1]]))
        for value in vars(status).values():
            if isinstance(value, np.ndarray):
                value[:] = 0
    assert (sim.distance_m == same.distance_m).all()
    assert (sim.heading_error_rad == same.heading_error_rad).all()
    assert (sim.eta == same.eta).all()


def test_each_boat_may_have_its_own_berth() -> None:
    west = replace(start_at(20, 0, 0, phase=1), goals=np.array([[25, 0, 0.9], [7, -2, 0.0]]))
    sim = simulator(start_at(20, 0, 180, phase=1), west)
    assert sim.distance_m == pytest.approx([16, math.hypot(13, 2)])


def test_without_an_intermediate_pose_there_is_one_phase() -> None:
    sim = Simulator(S1, [walled()], 1)
    sim.reset(np.array([0]), [given_start(own_site(S1), S1.task, np.array([36.0, 0.0, math.pi]), 0)])
    assert sim.step(IDLE).reached_final.tolist() == [True]


def test_each_boat_scans_and_collides_in_its_own_harbor() -> None:
    """Four boats at the same pose, two in open water and two in front of a wall, in mixed order."""
    starts = [replace(start_at(20, 0, 180), harbor=harbor) for harbor in (1, 0, 1, 0)]
    open_water, before_a_wall = walled(), walled(19.0)
    sim = Simulator(S3, [open_water, before_a_wall], 4)
    sim.prepare([0, 1])
    sensors = [world.lidar for world in (open_water, before_a_wall)]
    prepared = [sensor.scanned for sensor in sensors if isinstance(sensor, Rings)]
    sim.reset(np.arange(4), starts)
    assert [sensor.scanned for sensor in sensors if isinstance(sensor, Rings)] == [n + 2 for n in prepared]
    assert sim.step(np.zeros((4, 2))).collided.tolist() == [True, False, True, False]
    sim.eta = np.array([[x, 0.0, 0.1] for x in (1.0, 2.0, 3.0, 4.0)])
    assert np.array_equal(sim.scan(), Rings().sector_ranges(sim.eta))
    assert np.array_equal(sim.scan(np.array([2, 1])), Rings().sector_ranges(sim.eta[[2, 1]]))


def test_a_sensor_that_returns_another_shape_is_reported() -> None:
    world = replace(walled(), lidar=Rings(sectors=3))
    with pytest.raises(DockctlError, check=lambda error: error.code == "plugin"):
        Simulator(S3, [world], 1).reset(np.arange(1), [start_at(23, -10, 90)])
