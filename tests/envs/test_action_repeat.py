"""Actions that training holds for several control periods."""

from __future__ import annotations

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario


def scenario(repeat: int, *overrides: str) -> Scenario:
    return load("s3", overrides=[f"training.action_repeat={repeat}", *overrides]).scenario


@pytest.mark.parametrize("repeat", [1, 2, 3])
def test_a_step_of_training_is_as_many_control_periods(repeat: int) -> None:
    own = scenario(repeat)
    short, long = (DockingVectorEnv(s, 4) for s in (own, own.in_training()))
    for env in (short, long):
        env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(10):
        action = rng.integers(77, size=4)
        for _ in range(repeat):
            _, _, _, _, expected = short.step(action)
        _, _, _, _, info = long.step(action)
        for name in ("pose", "velocity", "sector_ranges_m", "distance_m"):
            np.testing.assert_allclose(info[name], expected[name], rtol=0, atol=1e-9)


@pytest.mark.parametrize("repeat", [1, 2, 3])
def test_step_limits_last_as_long(repeat: int) -> None:
    own = scenario(repeat, "task.max_steps=100", "training.exploring_starts.steps=40")
    stepped = own.in_training()
    exploring, shortened = own.training.exploring_starts, stepped.training.exploring_starts
    assert exploring is not None and shortened is not None
    assert stepped.vessel.control_period_s == repeat * own.vessel.control_period_s
    for before, after in (
        (own.task.max_steps, stepped.task.max_steps),
        (exploring.steps, shortened.steps),
    ):
        assert before <= after * repeat < before + repeat


def test_a_training_without_exploring_starts_has_none() -> None:
    assert scenario(2, "training.exploring_starts=null").in_training().training.exploring_starts is None
