"""Reward terms, parts of the observation, actions and environments that break a rule are rejected."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest

from dockctl import testing
from dockctl.envs.actions import GridActions
from dockctl.envs.observation import Columns, View, observation_part
from dockctl.envs.vector import DockingVectorEnv
from dockctl.plugins import ACTIONS
from dockctl.rewards.terms import reward_term
from dockctl.scenarios.extensions import register
from dockctl.sim.goal import StepStatus
from dockctl.testing.contract import Rule
from tests.testing.rejection import assert_rejected


def test_an_environment_that_shares_its_state_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    info = DockingVectorEnv._info

    def sharing(env: DockingVectorEnv, events: Any) -> Any:
        return {**info(env, events), "velocity": env.simulator.nu}

    monkeypatch.setattr(DockingVectorEnv, "_info", sharing)
    assert_rejected(lambda: testing.check_action_type("grid"), "deterministic")


def test_impure_terms_are_rejected() -> None:
    calls = iter(range(1000))

    @reward_term("drifting", kind="dense")
    def drifting(status: StepStatus) -> Any:
        return status.distance_m + next(calls)

    @reward_term("relative", kind="dense")
    def relative(status: StepStatus) -> Any:
        return status.distance_m - status.distance_m.mean()

    @reward_term("greedy", kind="dense")
    def greedy(status: StepStatus) -> Any:
        status.distance_m[:] = 0
        return status.distance_m

    @reward_term("inverse", kind="dense")
    def inverse(status: StepStatus) -> Any:
        with np.errstate(divide="ignore"):
            return 1 / status.distance_m

    @reward_term("number", kind="dense")
    def number(status: StepStatus) -> Any:
        return 0.0

    @reward_term("nothing", kind="dense")
    def nothing(status: StepStatus) -> Any:
        return None

    @reward_term("column", kind="dense")
    def column(status: StepStatus) -> Any:
        return status.distance_m[:, None]

    rules: dict[str, Rule] = {
        "drifting": "independent_rows",
        "relative": "independent_rows",
        "greedy": "pure",
        "inverse": "finite",
        "number": "shape",
        "nothing": "valid",
        "column": "shape",
    }
    for name, rule in rules.items():
        assert_rejected(lambda name=name: testing.check_reward_term(name), rule)  # type: ignore[misc]  # bound now


def test_a_part_without_bounds_is_rejected() -> None:
    @observation_part("boundless")
    def boundless(view: View) -> Columns:
        return Columns(["distance"], view.distance_m[:, None], 0, np.inf)

    assert_rejected(lambda: testing.check_observation_part("boundless"), "finite")


def test_commands_beyond_the_limits_are_rejected() -> None:
    @register(ACTIONS)
    class Strong(GridActions):
        kind: Literal["strong"] = "strong"  # type: ignore[assignment]

        def require_within_limits(self, vessel: Any) -> None:
            return

    assert_rejected(lambda: testing.check_action_type("strong", propeller_n=[60]), "in_range")


def test_one_command_of_many_beyond_the_limits_is_rejected() -> None:
    @register(ACTIONS)
    class NearlyRight(GridActions):
        kind: Literal["nearly_right"] = "nearly_right"  # type: ignore[assignment]

        def commands(self, actions: Any, vessel: Any) -> Any:
            return super().commands(actions, vessel) * np.where(actions == 3, 1.1, 1.0)[:, None]

    assert_rejected(lambda: testing.check_action_type("nearly_right"), "in_range")


def test_commands_in_an_array_that_is_used_again_are_rejected() -> None:
    arrays: dict[int, Any] = {}

    @register(ACTIONS)
    class Recycling(GridActions):
        kind: Literal["recycling"] = "recycling"  # type: ignore[assignment]

        def commands(self, actions: Any, vessel: Any) -> Any:
            array = arrays.setdefault(len(actions), np.zeros((len(actions), 2)))
            array[:] = super().commands(actions, vessel)
            return array

    assert_rejected(lambda: testing.check_action_type("recycling"), "unshared")
