"""Actuators: the delay to the exact step; lag and rate limit against closed forms; astern thrust; info."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.sim.checks import notes
from dockctl.sim.conditions.actuators import Actuators
from tests.sim.conditions.conditions import scenario, simulator

SUBSTEPS, SUBSTEP_S = 5, 0.1


def answers(keys: dict[str, object], commands: list[list[float]]) -> np.ndarray:
    """Return what one boat's actuators do with the commands, (steps, SUBSTEPS, 2)."""
    actuators = Actuators.model_validate({"kind": "actuators", **keys}).build(1)
    actuators.reset(np.array([0]), [np.random.default_rng(0)])
    held = np.repeat(np.array(commands)[:, None, None], SUBSTEPS, axis=2)
    return np.concatenate([actuators.actuate(command, SUBSTEP_S) for command in held])


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_delay_is_a_shift_by_whole_steps(delay: int) -> None:
    rng = np.random.default_rng(1)
    commands = rng.uniform(-1, 1, (12, 2)) * [50, 0.5]
    given = [np.vstack([np.zeros((delay, 2)), commands])[: len(commands)], commands]
    delayed, ideal = simulator(f"actuators: {{delay_steps: {delay}}}"), simulator("actuators: {}")
    calm = simulator("")
    for late, now in zip(given[0], given[1], strict=True):
        delayed.step(now[None])
        ideal.step(late[None])
        calm.step(late[None])
        assert np.array_equal(delayed.eta, ideal.eta)
        assert np.array_equal(delayed.eta, calm.eta)
        assert delayed.command.tolist() == [now.tolist()]
        assert delayed.actuation.tolist() == [late.tolist()]


def test_delays_are_drawn_per_episode_and_in_their_range() -> None:
    sim = simulator("actuators: {delay_steps: [0, 2]}", boats=60)
    delays = sim.disturbances.episode()["actuators_delay_steps"]
    assert {*delays} == {0.0, 1.0, 2.0}
    kick = np.zeros((60, 2))
    kick[:, 0] = 50
    for step in range(3):
        sim.step(kick)
        assert ((sim.nu[:, 0] > 0) == (delays <= step)).all()


def test_the_lag_is_first_order() -> None:
    force = answers({"propeller_lag_s": 0.2}, [[50, 0.0]] * 3)[:, :, 0].ravel()
    ends = SUBSTEP_S * np.arange(1, 16)
    integral = 50 * (ends - 0.2 * (1 - np.exp(-ends / 0.2)))  # of 50 (1 - exp(-t / T))
    np.testing.assert_allclose(np.cumsum(force) * SUBSTEP_S, integral, rtol=1e-12)


def test_the_rudder_turns_at_its_rate() -> None:
    angle = np.degrees(answers({"rudder_rate_degps": 30}, [[0, math.radians(30)]] * 3)[:, :, 1].ravel())
    ends = SUBSTEP_S * np.arange(1, 16)
    integral = np.where(ends < 1, 15 * ends**2, 15 + 30 * (ends - 1))  # 30 degrees after one second
    np.testing.assert_allclose(np.cumsum(angle) * SUBSTEP_S, integral, rtol=1e-12)
    # 10 degrees at 40 degrees a second: reached after a quarter of a second, and back
    angle = np.degrees(answers({"rudder_rate_degps": 40}, [[0, math.radians(10)], [0, 0]])[:, :, 1].ravel())
    expected = [2, 6, 9.375 + 0.0, 10, 10, 8, 4, 0.625, 0, 0]
    expected[2] = (8 + 10) / 2 * 0.5 + 10 * 0.5
    expected[7] = 10 - expected[2]
    assert angle == pytest.approx(expected)


def test_astern_thrust_is_a_factor_of_ahead_thrust() -> None:
    ahead, astern = answers({"astern_factor": 0.6}, [[50, 0.0], [-50, 0.0]])[:, 0, 0]
    assert (ahead, astern) == (50.0, -30.0)


def test_without_keys_nothing_changes() -> None:
    calm, ideal = simulator("", boats=3), simulator("actuators: {}", boats=3)
    for command in np.random.default_rng(2).uniform(-1, 1, (20, 3, 2)) * [50, 0.5]:
        calm.step(command)
        ideal.step(command)
    assert np.array_equal(calm.eta, ideal.eta)
    assert np.array_equal(calm.nu, ideal.nu)


def test_info_has_what_the_actuators_do() -> None:
    env = DockingVectorEnv(scenario("actuators: {delay_steps: 1}"), 1)
    _, info = env.reset(seed=0)
    assert info["actuation"].tolist() == [[0.0, 0.0]]
    _, _, _, _, info = env.step(np.array([76]))
    assert info["actuation"].tolist() == [[0.0, 0.0]]
    assert info["command"][0, 0] == 50
    _, _, _, _, info = env.step(np.array([76]))
    assert info["actuation"].tolist() == info["command"].tolist()


@pytest.mark.parametrize(
    ("ample", "scarce", "figures"),
    [
        ("delay_steps: 14", "delay_steps: [0, 15]", ("delay_steps", "7.5 s", "3.1 m")),
        ("propeller_lag_s: 7.2", "propeller_lag_s: [0, 20]", ("propeller_lag_s", "20 s", "8.2 m")),
        ("rudder_rate_degps: 4.2", "rudder_rate_degps: [1, 20]", ("rudder_rate_degps", "30 s", "12.4 m")),
        ("astern_factor: 0.1", "astern_factor: [0.05, 1]", ("astern_factor", "2.5 N", "50 N", "0.026 m/s")),
    ],
)
def test_actuators_that_leave_little_authority_are_noted(
    ample: str, scarce: str, figures: tuple[str, ...]
) -> None:
    """A thrust of 50 N is 94.2 u + 66 u^2 at 0.412 m/s, and 2.5 N at 0.026 m/s; 3 m take 7.28 s."""
    assert notes(scenario(f"actuators: {{{ample}}}")) == []
    (note,) = notes(scenario(f"actuators: {{{scarce}}}"))
    field, *numbers = figures
    assert f"conditions.actuators.{field}" in note
    assert all(number in note for number in numbers), note
