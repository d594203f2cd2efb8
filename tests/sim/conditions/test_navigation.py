"""Errors of the measured pose and velocity: their size, and that only observations have them."""

from __future__ import annotations

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import wrap
from tests.sim.conditions.conditions import scenario, simulator
from tests.sim.worlds import walled

NOISE = "navigation: {position_m: 0.02, velocity_mps: 0.03, heading_deg: 0.5, yaw_rate_degps: 0.2}"


def test_the_errors_have_the_given_standard_deviations_and_no_memory() -> None:
    boats = 4000
    sim = simulator(NOISE, boats=boats)
    first = np.hstack([sim.measured_pose() - sim.eta, sim.measured_velocity() - sim.nu])
    sim.step(np.zeros((boats, 2)))
    second = np.hstack([sim.measured_pose() - sim.eta, sim.measured_velocity() - sim.nu])
    expected = [0.02, 0.02, np.radians(0.5), 0.03, 0.03, np.radians(0.2)]
    for errors in (first, second):
        assert errors.std(axis=0) == pytest.approx(expected, rel=0.05)
        assert np.abs(errors.mean(axis=0) / expected).max() < 4 / np.sqrt(boats)
        assert np.abs(np.corrcoef(errors.T) - np.eye(6)).max() < 5 / np.sqrt(boats)
    assert np.abs((first * second).mean(axis=0) / np.square(expected)).max() < 5 / np.sqrt(boats)


def test_only_observations_have_the_errors() -> None:
    noisy, exact = (DockingVectorEnv(scenario(text), 3, worlds=[walled()]) for text in (NOISE, ""))
    results = [env.reset(seed=1) for env in (noisy, exact)]
    parts = np.array(noisy.observation_parts)
    for _ in range(20):
        (seen, noisy_info), (true, info) = results
        for key in ("pose", "velocity", "distance_m", "heading_error_rad"):
            assert np.array_equal(noisy_info[key], info[key])
        goal, measured = info["goal"], noisy_info["measured_pose"]
        scaled = np.hypot(*(measured - goal)[:, :2].T) / 10
        assert seen[:, parts == "distance"][:, 0] == pytest.approx(scaled, abs=1e-6)
        turn = wrap(measured[:, 2] - goal[:, 2])
        assert seen[:, parts == "heading_error"][:, 0] == pytest.approx(turn, abs=1e-6)
        exactly = np.isin(parts, ("lidar", "command"))
        assert np.array_equal(seen[:, exactly], true[:, exactly])
        assert not np.array_equal(seen[:, parts == "velocity"], true[:, parts == "velocity"])
        steps = [env.step(np.full(3, 73)) for env in (noisy, exact)]
        assert np.array_equal(steps[0][1], steps[1][1])
        results = [(step[0], step[4]) for step in steps]
