"""Conditions that break a rule are rejected."""

from __future__ import annotations

import copy
from typing import Any, Literal

import numpy as np
import pytest

from dockctl import testing
from dockctl.errors import PluginError
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.extensions import Condition, Disturbance, register
from dockctl.testing.contract import Rule
from tests.conftest import own_registries
from tests.testing.rejection import assert_rejected


def test_a_condition_that_draws_from_a_common_generator_is_rejected() -> None:
    common = np.random.default_rng(0)

    class Flow(Disturbance):
        def __init__(self, boats: int) -> None:
            self.velocity = np.zeros((boats, 2))

        def reset(self, rows: Any, rngs: Any) -> None:
            self.velocity[rows] = common.random((len(rows), 2))

        def water_velocity(self) -> Any:
            return self.velocity

    @register(CONDITIONS, group="water")
    class Unseeded(Condition):
        kind: Literal["unseeded"] = "unseeded"

        def build(self, num_boats: int) -> Disturbance:
            return Flow(num_boats)

    assert_rejected(lambda: testing.check_condition("unseeded"), "deterministic")


class Gusts(Disturbance):
    """A correct condition: a flow drawn per episode, and a force that grows with its time."""

    def __init__(self, boats: int) -> None:
        self.velocity, self.time_s = np.zeros((boats, 2)), np.zeros(boats)

    def reset(self, rows: Any, rngs: Any) -> None:
        self.velocity[rows] = [rng.random(2) for rng in rngs]
        self.time_s[rows] = 0

    def advance(self, period_s: float) -> None:
        self.time_s = self.time_s + period_s

    def water_velocity(self) -> Any:
        return self.velocity

    def force(self, eta: Any, nu: Any) -> Any:
        return self.time_s[:, None] * [1.0, 0.0, 0.0]


class FirstGenerator(Gusts):
    def reset(self, rows: Any, rngs: Any) -> None:
        super().reset(rows, [rngs[0]] + [copy.deepcopy(rngs[0]) for _ in rngs[1:]])


class LastingTime(Gusts):
    def reset(self, rows: Any, rngs: Any) -> None:
        self.velocity[rows] = [rng.random(2) for rng in rngs]


class ChangesArgument(Gusts):
    def force(self, eta: Any, nu: Any) -> Any:
        nu[:] = 0
        return super().force(eta, nu)


class NotFinite(Gusts):
    def force(self, eta: Any, nu: Any) -> Any:
        return np.full((len(eta), 3), np.nan)


class NoRanges(Gusts):
    def reported_ranges(self, ranges: Any, rows: Any, range_m: float) -> Any:
        return np.full_like(ranges, np.nan)


class LosesSectors(Gusts):
    def reported_ranges(self, ranges: Any, rows: Any, range_m: float) -> Any:
        return ranges[:, 1:]


class Unsaveable(Gusts):
    def __init__(self, boats: int) -> None:
        super().__init__(boats)
        self.scale = lambda: 1


def check_gusty(state: type[Gusts]) -> None:
    """Check a condition whose disturbance is `state`."""

    class Gusty(Condition):
        kind: Literal["gusty"] = "gusty"

        def build(self, num_boats: int) -> Disturbance:
            return state(num_boats)

    with own_registries():
        register(CONDITIONS, group="water")(Gusty)
        testing.check_condition("gusty")


@pytest.mark.parametrize(
    ("state", "rule"),
    [
        (FirstGenerator, "independent_rows"),
        (LastingTime, "deterministic"),
        (ChangesArgument, "pure"),
        (NotFinite, "finite"),
        (Unsaveable, "resumable"),
    ],
)
def test_conditions_that_break_a_rule_are_rejected(state: type[Gusts], rule: Rule) -> None:
    assert_rejected(lambda: check_gusty(state), rule)


def test_a_condition_that_breaks_no_rule_passes() -> None:
    check_gusty(Gusts)


@pytest.mark.parametrize(("state", "reason"), [(NoRanges, "not finite"), (LosesSectors, "shape")])
def test_ranges_that_the_simulator_refuses_name_the_hook(state: type[Gusts], reason: str) -> None:
    with pytest.raises(PluginError, match=rf"{state.__name__}.reported_ranges returned .*{reason}"):
        check_gusty(state)


def test_a_condition_whose_state_is_incomplete_is_rejected() -> None:
    class Flow(Disturbance):
        def __init__(self, boats: int) -> None:
            self.velocity, self.factor = np.zeros((boats, 2)), np.zeros((boats, 1))

        def reset(self, rows: Any, rngs: Any) -> None:
            self.velocity[rows] = [rng.random(2) for rng in rngs]
            self.factor[rows] = [rng.random(1) for rng in rngs]

        def water_velocity(self) -> Any:
            return self.velocity * self.factor

        def state(self) -> dict[str, Any]:
            return {"velocity": self.velocity}

    @register(CONDITIONS, group="water")
    class Forgetful(Condition):
        kind: Literal["forgetful"] = "forgetful"

        def build(self, num_boats: int) -> Disturbance:
            return Flow(num_boats)

    assert_rejected(lambda: testing.check_condition("forgetful"), "resumable")
