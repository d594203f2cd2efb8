"""Forecasts against the simulator: what the boats then do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dockctl.evaluation.forecast import Forecast
from dockctl.scenarios.loader import load
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from tests.sim.worlds import walled

FLOWS = (
    "current: {speed_mps: 0.1, direction_deg: 70, variation_mps: 0}",
    "wind: {speed_mps: 4, direction_deg: 200, gust_mps: 0}",
)


def boats(count: int, *conditions: str) -> Simulator:
    loaded = load("s1", overrides=[f"conditions={{{', '.join(conditions)}}}", "vessel.control_period_s=1.0"])
    simulator = Simulator(loaded.scenario, [walled()], count)
    site = own_site(loaded.scenario)
    starts = [
        given_start(site, loaded.scenario.task, np.array([20.0, 0.0, 2.0 * i]), i) for i in range(count)
    ]
    simulator.reset(np.arange(count), starts, [np.random.default_rng(i) for i in range(count)])
    return simulator


def sailed(simulator: Simulator, steps: int, seed: int = 0) -> Forecast:
    """Return a forecast after some steps with random commands, each held for three of them."""
    forecast, rng = Forecast(simulator), np.random.default_rng(seed)
    rows = np.arange(len(simulator.eta))
    forecast.reset(rows)
    for step in range(steps):
        forecast.measure(simulator.measured_pose(), simulator.measured_velocity())
        if step % 3 == 0:
            commands = rng.uniform(-1, 1, (len(rows), 2)) * simulator.vessel.command_limit
        forecast.command(commands)
        simulator.step(commands)
    forecast.measure(simulator.measured_pose(), simulator.measured_velocity())
    return forecast


@pytest.mark.parametrize("delay", [0, 1])
def test_without_errors_boats_do_what_is_predicted(delay: int) -> None:
    simulator = boats(3, *FLOWS, f"actuators: {{delay_steps: {delay}}}")
    forecast = sailed(simulator, 12)
    assert forecast.delayed.tolist() == [bool(delay)] * 3
    commands = np.random.default_rng(1).uniform(-1, 1, (3, 8, 2)) * simulator.vessel.command_limit
    poses, velocity = forecast.poses(np.arange(3), commands)
    for step in range(8):
        simulator.step(commands[:, step])
        assert poses[:, 2 * step + 1] == pytest.approx(simulator.eta, abs=0.05)
        assert velocity[:, step] == pytest.approx(simulator.nu[:, :2], abs=0.02)


def test_a_boat_may_have_several_predictions() -> None:
    forecast = sailed(boats(2, *FLOWS), 5)
    commands = np.random.default_rng(1).uniform(-1, 1, (3, 4, 2)) * [50.0, 0.5]
    together, _ = forecast.poses(np.array([1, 0, 1]), commands)
    for number, row in enumerate((1, 0, 1)):
        alone, _ = forecast.poses(np.array([row]), commands[[number]])
        np.testing.assert_array_equal(together[[number]], alone)


def test_noise_is_averaged() -> None:
    """Boats adrift: the standard deviation of a mean of 21 values is smaller by sqrt(21)."""
    noise: dict[str, Any] = {"velocity_mps": 0.05, "position_m": 0, "heading_deg": 0, "yaw_rate_degps": 0}
    simulator = boats(20, *FLOWS, f"navigation: {noise}")
    forecast, still = sailed(simulator, 20), np.zeros((20, 30, 2))
    poses, _ = forecast.poses(np.arange(20), still)
    for _ in range(30):
        simulator.step(still[:, 0])
    off = np.hypot(*(poses[:, -1] - simulator.eta)[:, :2].T)
    assert np.sqrt((off**2).mean()) == pytest.approx(30 * 0.05 * np.sqrt(2 / 21), rel=0.35)


def test_a_new_episode_knows_nothing_of_the_last() -> None:
    simulator = boats(2, *FLOWS, "actuators: {delay_steps: 1}")
    forecast = sailed(simulator, 12)
    forecast.reset(np.array([0]))
    forecast.measure(simulator.eta, simulator.nu)
    assert forecast.delayed.tolist() == [False, True]
