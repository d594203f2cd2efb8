"""Forecasts against the simulator: what the boats then do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dockctl.control.forecast import Forecast
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.conditions.actuators import RealActuators
from dockctl.sim.conditions.wind import UniformWind
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from tests.sim.worlds import walled

FLOWS = (
    "current: {speed_mps: 0.1, direction_deg: 70, variation_mps: 0}",
    "wind: {speed_mps: 4, direction_deg: 200, gust_mps: 0}",
)


def boats(count: int, *conditions: str) -> tuple[Simulator, Scenario]:
    loaded = load(
        "s1",
        overrides=[
            f"conditions={{{', '.join(conditions)}}}",
            "vessel.control_period_s=1.0",
            "vessel.substeps=10",
        ],
    )
    simulator = Simulator(loaded.scenario, [walled()], count)
    site = own_site(loaded.scenario)
    starts = [
        given_start(site, loaded.scenario.task, np.array([20.0, 0.0, 2.0 * i]), i) for i in range(count)
    ]
    simulator.reset(np.arange(count), starts, [np.random.default_rng(i) for i in range(count)])
    return simulator, loaded.scenario


def sailed(given: tuple[Simulator, Scenario], steps: int, seed: int = 0) -> Forecast:
    """Return a forecast after some steps with random commands, each held for three of them."""
    simulator, scenario = given
    forecast, rng = Forecast(simulator, scenario), np.random.default_rng(seed)
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


@pytest.mark.parametrize("delay", [0, 1, 2])
def test_without_errors_boats_do_what_is_predicted(delay: int) -> None:
    actuators = f"actuators: {{delay_steps: {delay}, propeller_lag_s: 0.4, rudder_rate_degps: 20}}"
    simulator, scenario = boats(3, *FLOWS, actuators)
    forecast = sailed((simulator, scenario), 12)
    commands = np.random.default_rng(1).uniform(-1, 1, (3, 8, 2)) * simulator.vessel.command_limit
    predicted = [forecast.poses(row, commands[[row]]) for row in range(3)]
    poses, velocity = (np.concatenate(parts) for parts in zip(*predicted, strict=True))
    for step in range(8):
        simulator.step(commands[:, step])
        assert poses[:, 2 * step + 1] == pytest.approx(simulator.eta, abs=0.05)
        assert velocity[:, step] == pytest.approx(simulator.nu[:, :2], abs=0.02)


def test_delay_lag_and_thrust_astern_are_found() -> None:
    """Without errors, the middle of its range is what keeps the astern factor from being exact."""
    ranges = "{delay_steps: [0, 3], propeller_lag_s: [0, 2], astern_factor: [0.5, 1.5]}"
    simulator, scenario = boats(20, *FLOWS, f"actuators: {ranges}")
    own = next(each for each in simulator.disturbances if isinstance(each, RealActuators))
    own.lag[:] = np.arange(20) % 3  # the lags that are compared
    delay, lag, astern = sailed((simulator, scenario), 150).actuators()
    assert delay.tolist() == own.delay.tolist()
    assert lag.tolist() == own.lag.tolist()
    np.testing.assert_allclose(astern, own.astern, rtol=0, atol=0.05)


def test_unknown_masses_and_gusts_leave_the_delay_certain() -> None:
    weather = (
        "wind: {speed_mps: 5, direction_deg: 200, gust_mps: 1.5}",
        "uncertainty: {masses: 0.2, damping: 0.2}",
    )
    noise = "navigation: {velocity_mps: 0.03, position_m: 0.02, heading_deg: 0.5, yaw_rate_degps: 0.2}"
    simulator, scenario = boats(
        20, *weather, noise, "actuators: {delay_steps: [0, 2], astern_factor: [0.7, 1]}"
    )
    own = next(each for each in simulator.disturbances if isinstance(each, RealActuators))
    delay, _, _ = sailed((simulator, scenario), 20).actuators()
    assert delay.tolist() == own.delay.tolist()


def test_a_boat_may_have_several_predictions() -> None:
    forecast = sailed(boats(2, *FLOWS, "actuators: {delay_steps: 1, propeller_lag_s: 1}"), 5)
    commands = np.random.default_rng(1).uniform(-1, 1, (3, 4, 2)) * [50.0, 0.5]
    together, _ = forecast.poses(1, commands)
    for number in range(3):
        alone, _ = forecast.poses(1, commands[[number]])
        np.testing.assert_array_equal(together[[number]], alone)


def test_noise_is_averaged() -> None:
    """Boats adrift: the standard deviation of a mean of 21 values is smaller by sqrt(21)."""
    noise: dict[str, Any] = {"velocity_mps": 0.05, "position_m": 0, "heading_deg": 0, "yaw_rate_degps": 0}
    simulator, scenario = boats(20, *FLOWS, f"navigation: {noise}")
    forecast, still = sailed((simulator, scenario), 20), np.zeros((20, 30, 2))
    poses = np.concatenate([forecast.poses(row, still[:1])[0] for row in range(20)])
    for _ in range(30):
        simulator.step(still[:, 0])
    off = np.hypot(*(poses[:, -1] - simulator.eta)[:, :2].T)
    assert np.sqrt((off**2).mean()) == pytest.approx(30 * 0.05 * np.sqrt(2 / 21), rel=0.35)


@pytest.mark.parametrize("gust_time_s", [1, 2, 10])
def test_a_gust_acts_in_the_next_step_and_then_fades(gust_time_s: float) -> None:
    """Two boats adrift in the same wind, the second in a gust that fades without noise."""
    wind_only = f"wind: {{speed_mps: 4, direction_deg: 200, gust_mps: 0, gust_time_s: {gust_time_s}}}"
    simulator, scenario = boats(2, wind_only)
    simulator.eta[1] = simulator.eta[0]
    wind = next(each for each in simulator.disturbances if isinstance(each, UniformWind))
    forecast, still = Forecast(simulator, scenario), np.zeros((2, 8, 2))
    for gust_mps in (*[0.0] * 20, 1.5):
        wind.gust[1] = gust_mps
        forecast.measure(simulator.eta, simulator.nu)
    predicted = np.concatenate([forecast.poses(row, still[:1])[1] for row in range(2)])
    for step in range(8):
        simulator.step(still[:, step])
        assert predicted[:, step] == pytest.approx(simulator.nu[:, :2], abs=0.0015)
    assert np.hypot(*(predicted[1] - predicted[0]).T).max() > 0.01


def test_noise_of_poses_is_reduced() -> None:
    noise = "navigation: {position_m: 0.1, heading_deg: 0.5, velocity_mps: 0.03, yaw_rate_degps: 0.1}"
    simulator, scenario = boats(100, *FLOWS, noise)
    forecast, still = sailed((simulator, scenario), 20), np.zeros((100, 1, 2))
    poses = np.concatenate([forecast.poses(row, still[:1])[0] for row in range(100)])
    simulator.step(still[:, 0])
    x, y, heading = (poses[:, 1] - simulator.eta).std(axis=0)
    assert max(x, y) < 0.7 * 0.1
    assert heading < 0.7 * np.radians(0.5)


def test_a_new_episode_knows_nothing_of_the_last() -> None:
    simulator, scenario = boats(2, *FLOWS, "actuators: {delay_steps: [0, 1], astern_factor: [0.7, 1]}")
    own = next(each for each in simulator.disturbances if isinstance(each, RealActuators))
    own.delay[:] = 1
    forecast = sailed((simulator, scenario), 12)
    assert forecast.actuators()[0].tolist() == [1, 1]
    forecast.reset(np.array([0]))
    forecast.measure(simulator.eta, simulator.nu)
    delay, _, astern = forecast.actuators()
    assert delay.tolist() == [0, 1]
    assert astern[0] == pytest.approx(0.85)
