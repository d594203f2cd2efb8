"""Equations 3.10 and 3.13 against values computed by hand, on both sides of every case."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.errors import DockctlError
from dockctl.plugins import REWARD_TERMS
from dockctl.rewards.compose import RewardFunction
from dockctl.rewards.terms import reward_term
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Reward
from dockctl.sim.goal import StepStatus

S1, S3 = load("s1").scenario.reward, load("s3").scenario.reward
IN_METERS = S1.model_copy(update={"distance_unit_m": 1.0})
EVENTS = ("collided", "reached_intermediate", "reached_final")


def status(
    distance: float = 10.0, error_deg: float = 0.0, u: float = 0.0, v: float = 0.0, **given: Any
) -> StepStatus:
    """One boat's step; `given` names an event, or another value."""
    values: dict[str, Any] = {
        "phase": np.array([1]),
        "distance_m": np.array([distance]),
        "heading_error_rad": np.radians([error_deg]),
        "previous_distance_m": np.array([distance]),
        "previous_heading_error_rad": np.radians([error_deg]),
        "eta": np.zeros((1, 3)),
        "nu": np.array([[u, v, 0.7]]),
        "command": np.zeros((1, 2)),
        "previous_command": np.zeros((1, 2)),
        "sector_ranges_m": np.full((1, 8), 100.0),
        **{event: np.array([False]) for event in EVENTS},
    }
    return StepStatus(**{**values, **{name: np.array([value]) for name, value in given.items()}})


def total(reward: Reward, given: StepStatus) -> float:
    return float(RewardFunction(reward)(given)[0][0])


def only(**terms: Any) -> Reward:
    return Reward.model_validate({"distance_unit_m": 20.0, "terms": terms})


@pytest.fixture
def registered() -> Iterator[None]:
    """Forget the terms that a test registers."""
    before = REWARD_TERMS.save()
    yield
    REWARD_TERMS.restore(before)


def test_at_rest_at_the_start_of_scenario_one() -> None:
    """At (20, 2), 20 degrees off: 16 m and 2 m from the final pose."""
    start = status(math.hypot(16, 2), 20.0)
    assert total(IN_METERS, start) == pytest.approx(-2453.58, abs=0.005)
    assert total(S1, start) == pytest.approx(-155.84, abs=0.005)


@pytest.mark.parametrize(("reward", "weight"), [(S1, 20.0), (S3, 10.0)])
def test_dense_terms_by_hand(reward: Reward, weight: float) -> None:
    expected = -150 * 5 / 20 - 100 * math.radians(30) - weight * 0.5 / (5 / 20)
    assert total(reward, status(5.0, 30.0, u=-0.3, v=0.4)) == pytest.approx(expected)
    assert total(reward, status(5.0, -30.0, u=0.3, v=-0.4)) == pytest.approx(expected)


@pytest.mark.parametrize("phase", [0, 1])
def test_the_terms_do_not_depend_on_the_phase(phase: int) -> None:
    assert total(S3, status(5.0, 30.0, phase=phase)) == pytest.approx(-150 / 4 - 100 * math.radians(30))


def test_only_the_term_of_the_event_applies() -> None:
    assert total(S1, status(5.0, 30.0, u=0.3, collided=True)) == -30_000
    assert total(S1, status(0.5, 3.0, u=0.1, reached_final=True)) == 30_000
    assert total(S3, status(1.0, 3.0, u=0.1, reached_intermediate=True)) == 30_000
    assert total(S3, status(0.5, 3.0, reached_final=True)) == 30_000


def test_an_event_without_a_term_has_no_reward() -> None:
    assert total(S1, status(5.0, 30.0, reached_intermediate=True)) == 0
    assert total(only(distance=-150), status(5.0, collided=True)) == 0


@pytest.mark.parametrize(
    ("distance", "divisor"), [(0.0, 0.02), (0.39, 0.02), (0.4, 0.02), (0.41, 0.0205), (2, 0.1)]
)
def test_the_speed_term_has_a_floor(distance: float, divisor: float) -> None:
    """0.02 units of 20 m are 0.4 m."""
    assert total(only(speed=-1), status(distance, u=0.3, v=0.4)) == pytest.approx(-0.5 / divisor)


@pytest.mark.parametrize(("unit_m", "expected"), [(20.0, -25.0), (1.0, -1.25), (5.0, -6.25)])
def test_the_floor_is_the_same_distance_in_every_unit(unit_m: float, expected: float) -> None:
    """0.5 m/s at 0.4 m: at 0.3 m and at 0 m the term is the same, at 0.5 m it is less."""
    reward = only(speed=-1).model_copy(update={"distance_unit_m": unit_m})
    for distance in (0.0, 0.3, 0.4):
        assert total(reward, status(distance, u=0.3, v=0.4)) == pytest.approx(expected)
    assert total(reward, status(0.5, u=0.3, v=0.4)) == pytest.approx(0.8 * expected)


@pytest.mark.parametrize("params", [{"floor_m": 10.0}, {"floor": 0.5}])
def test_the_floor_is_a_parameter_in_runs_of_earlier_versions_in_units(params: dict[str, float]) -> None:
    reward = only(speed={"weight": -1, "params": params})
    assert total(reward, status(1.0, u=0.3, v=0.4)) == pytest.approx(-1.0)


def test_a_term_may_have_its_own_unit() -> None:
    reward = only(distance={"weight": -150, "params": {"distance_unit_m": 1}}, orientation=-100)
    assert total(reward, status(7.0)) == pytest.approx(-1050)


def test_progress_is_the_decrease_of_the_potential() -> None:
    """From 10 m and -20 degrees to 9.5 m and 25 degrees, kappa 20."""
    step = status(9.5, 25.0, previous_distance_m=10.0, previous_heading_error_rad=math.radians(-20))
    expected = 20 * (150 * 0.5 - 100 * math.radians(5))
    assert total(only(progress=20), step) == pytest.approx(expected)
    assert total(only(progress=20, final=1), status(reached_final=True, previous_distance_m=12.0)) == 1


@pytest.mark.parametrize(("meters", "expected"), [(0.0, 1.0), (0.1, 0.8), (0.5, 0.0), (3.0, 0.0)])
def test_clearance_counts_below_the_margin(meters: float, expected: float) -> None:
    near = replace(status(), clearance_below=lambda limit_m: np.minimum([meters], limit_m))
    assert total(only(clearance=-1), near) == pytest.approx(-expected)
    wide = only(clearance={"weight": -1, "params": {"margin_m": 4.0}})
    assert total(wide, near) == pytest.approx(-(1 - meters / 4))


def test_command_changes_count_in_units_of_the_limits() -> None:
    """From 50 N and -30 degrees to -50 N and 30 degrees, and to 20 N and -15 degrees."""
    before = [50.0, math.radians(-30)]
    assert total(
        only(command_change=-2), status(previous_command=before, command=[-50.0, math.radians(30)])
    ) == pytest.approx(-8)
    step = status(previous_command=before, command=[20.0, math.radians(-15)])
    assert total(only(command_change=1), step) == pytest.approx(30 / 50 + 15 / 30)
    own = {"weight": 1, "params": {"per_n": 10, "per_deg": 5}}
    assert total(only(command_change=own), step) == pytest.approx(3 + 3)
    assert total(only(command_change=1), status(previous_command=before, command=before)) == 0


@pytest.mark.parametrize(
    ("distance", "speed", "excess"),
    [
        (8.0, 0.5, 0.1),
        (8.0, 0.4, 0.0),
        (2.0, 0.25, 0.05),
        (0.5, 0.12, 0.02),
        (0.0, 0.1, 0.0),
        (0.0, 0.3, 0.2),
    ],
)
def test_the_speed_limit_grows_with_the_root_of_the_distance(
    distance: float, speed: float, excess: float
) -> None:
    """sqrt(2 * 0.01 * 8) = 0.4, sqrt(2 * 0.01 * 2) = 0.2, at least 0.1 m/s."""
    step = status(distance, u=-0.6 * speed, v=0.8 * speed)
    assert total(only(overspeed=-10), step) == pytest.approx(-10 * excess, abs=1e-12)
    assert total(only(overspeed={"weight": 1, "params": {"deceleration_mps2": 100}}), status(1, u=0.4)) == 0


@given(
    st.floats(0, 80),
    st.floats(-180, 180),
    st.floats(-0.5, 0.5),
    st.floats(-0.2, 0.2),
    st.sampled_from(["", *EVENTS]),
)
def test_the_breakdown_adds_up_and_one_kind_applies(
    distance: float, error: float, u: float, v: float, event: str
) -> None:
    reward, parts = RewardFunction(S3)(status(distance, error, u, v, **({event: True} if event else {})))
    assert set(parts) == {"collision", "intermediate", "final", "distance", "orientation", "speed"}
    assert sum(part[0] for part in parts.values()) == pytest.approx(reward[0])
    nonzero = {name for name, part in parts.items() if part[0] != 0}
    of_event = {"collided": "collision", "reached_intermediate": "intermediate", "reached_final": "final"}
    assert nonzero <= ({of_event[event]} if event else {"distance", "orientation", "speed"})


def test_the_reward_of_a_boat_does_not_depend_on_other_boats() -> None:
    boats = [status(5.0, 30.0, u=0.2), status(3.0, collided=True), status(0.2, reached_final=True)]
    arrays = [k for k, value in vars(boats[0]).items() if isinstance(value, np.ndarray)]
    together = StepStatus(**{k: np.concatenate([getattr(b, k) for b in boats]) for k in arrays})
    reward, _ = RewardFunction(S1)(together)
    assert reward.tolist() == [total(S1, boat) for boat in boats]


def test_unknown_term() -> None:
    with pytest.raises(DockctlError, check=lambda error: error.suggestion == "distance"):
        RewardFunction(only(distnace=-1))


def test_unknown_parameter() -> None:
    with pytest.raises(DockctlError, check=lambda error: error.suggestion == "floor"):
        RewardFunction(only(speed={"weight": -1, "params": {"flor": 1}}))


@pytest.mark.usefixtures("registered")
def test_a_registered_term_takes_parameters_and_a_missing_one_is_an_error() -> None:
    @reward_term("yaw_rate", kind="dense", source="a test")
    def yaw_rate(status: StepStatus, *, power: int) -> Any:
        return np.abs(status.nu[:, 2]) ** power

    assert total(only(yaw_rate={"weight": -2, "params": {"power": 2}}), status()) == pytest.approx(-0.98)
    with pytest.raises(DockctlError, match="'power'") as caught:
        RewardFunction(only(yaw_rate=-2))
    assert caught.value.code == "missing_key"


@pytest.mark.usefixtures("registered")
def test_a_term_of_the_wrong_shape_or_kind_is_rejected() -> None:
    @reward_term("lopsided", kind="dense")
    def lopsided(status: StepStatus) -> Any:
        return status.nu

    with pytest.raises(DockctlError, match="'lopsided'") as caught:
        total(only(lopsided=1), status())
    assert caught.value.code == "plugin"
    with pytest.raises(DockctlError) as caught:
        reward_term("odd", kind="sparse")  # type: ignore[arg-type]  # what is tested
    assert caught.value.code == "unknown_name"
