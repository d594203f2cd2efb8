"""The pilot stops the boat at every bad input."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dockctl.pilot import Checks, Pilot, Reading
from tests.pilot.inputs import AWAY, CLOUD, REST, decide, in_wind, observed


class Raising:
    """An object whose numbers cannot be read."""

    def __array__(self, *args: Any, **options: Any) -> Any:
        raise RuntimeError


BAD = {
    "no pose yet": {"pose": None},
    "no velocity yet": {"velocity": None},
    "no cloud yet": {"cloud": None},
    "pose too old": {"pose": Reading(9.4, AWAY)},
    "velocity too old": {"velocity": Reading(9.4, REST)},
    "cloud too old": {"cloud": Reading(9.4, CLOUD)},
    "cloud of the future": {"cloud": Reading(10.6, CLOUD)},
    "time is NaN": {"pose": Reading(math.nan, AWAY)},
    "time is text": {"pose": Reading("now", AWAY)},  # type: ignore[arg-type]  # wrong on purpose
    "time is a number as text": {"pose": Reading("10", AWAY)},  # type: ignore[arg-type]  # wrong on purpose
    "pose is NaN": {"pose": (23.0, math.nan, 1.0)},
    "heading is infinite": {"pose": (23.0, -10.0, math.inf)},
    "velocity is NaN": {"velocity": (math.nan, 0.0, 0.0)},
    "pose without heading": {"pose": (23.0, -10.0)},
    "pose is text": {"pose": ("x", "y", "z")},
    "pose is a number as text": {"pose": ("23", "-10", "1.5")},
    "pose is true": {"pose": (True, True, True)},
    "pose is a duration": {"pose": np.array([1, 2, 3], "m8[s]")},
    "pose is complex": {"pose": np.array([23, -10, 1j])},
    "pose raises": {"pose": Raising()},
    "points are far beyond everything": {"cloud": np.array([[1e308, 0.0, 0.0]])},
    "pose is no floating-point number": {"pose": (10**400, 0, 0)},
    "time is no floating-point number": {"cloud": Reading(10**400, CLOUD)},
    "points are NaN": {"cloud": np.array([[1.0, math.nan, 0.0]])},
    "points are masked": {"cloud": np.ma.masked_less(CLOUD, CLOUD.max())},
    "pose is masked": {"pose": np.ma.array((23, -10, 1), mask=(0, 0, 1))},
    "points are infinite": {"cloud": np.array([[1.0, math.inf, 0.0]])},
    "points in a plane": {"cloud": CLOUD[:, :2]},
    "points in millimeters": {"cloud": 1000 * CLOUD},
    "no points": {"cloud": CLOUD[:0]},
    "surge": {"velocity": (2.1, 0.0, 0.0)},
    "sway": {"velocity": (0.0, -0.51, 0.0)},
    "yaw rate": {"velocity": (0.0, 0.0, 0.21)},
    "a jump": {"pose": (23.0, -4.9, 1.5)},
}


@pytest.mark.parametrize("name", BAD)
def test_bad_inputs_stop_the_boat(pilot: Pilot, name: str) -> None:
    """The last decision was one second before: 2 m/s and 1 m allow 3 m."""
    assert not decide(pilot, 9.0).stop
    decision = decide(pilot, 10.0, **BAD[name])
    (subject,) = BAD[name]
    assert decision.stop.startswith({"sway": "v", "surge": "u", "yaw rate": "r"}.get(name, subject))
    assert (decision.propeller_n, decision.rudder_rad, decision.action) == (0, 0, None)
    after = decide(pilot, 11.0, pose=BAD[name]["pose"] if name == "a jump" else AWAY)
    assert after.stop == ""
    assert after.observation is not None and after.observation[6:8].tolist() == [0, 0]  # of the stop


NO_TIMES: list[Any] = [
    "10.0",
    None,
    math.nan,
    math.inf,
    True,
    np.True_,
    [10.0],
    np.array([10.0]),
    10j,
    10**400,
]


@pytest.mark.parametrize("now_s", NO_TIMES, ids=lambda value: str(value)[:8])
def test_what_is_no_time_stops_the_boat(pilot: Pilot, now_s: Any) -> None:
    assert not decide(pilot, 9.0).stop
    decision = pilot.decide(now_s, Reading(10.0, AWAY), Reading(10.0, REST), {"bow": Reading(10.0, CLOUD)})
    assert decision.stop.startswith("now_s")
    assert (decision.propeller_n, decision.rudder_rad, decision.action) == (0, 0, None)
    assert decide(pilot, 11.0).stop == ""


@pytest.mark.parametrize("now_s", [10, np.float32(10.0), np.int64(10)])
def test_a_time_is_any_real_number(pilot: Pilot, now_s: Any) -> None:
    assert decide(pilot, now_s).stop == ""


BAD_FLOWS = {
    "never arrived": None,
    "without a time": (1.0, 0.0),
    "too old": Reading(9.4, (1.0, 0.0)),
    "NaN": Reading(10.0, (math.nan, 0.0)),
    "three numbers": Reading(10.0, (1.0, 0.0, 0.0)),
    "text": Reading(10.0, ("x", "y")),
    "too fast": Reading(10.0, (0.0, 26.0)),
}


@pytest.mark.parametrize("name", ["apparent_wind", "through_water"])
@pytest.mark.parametrize("bad", BAD_FLOWS)
def test_bad_measurements_of_air_and_water_stop_the_boat(weather: Pilot, name: str, bad: str) -> None:
    weather.reset()
    assert not in_wind(weather, 9.0, velocity=Reading(9.0, (0.3, 0.0, 0.0))).stop
    decision = in_wind(weather, 10.0, **{name: BAD_FLOWS[bad]})
    columns = {"apparent_wind": "wind_port", "through_water": "v_water"}
    assert decision.stop.startswith(columns[name] if bad == "too fast" else name)
    assert (decision.propeller_n, decision.rudder_rad, decision.action) == (0, 0, None)
    after = observed(weather, in_wind(weather, 11.0))
    assert [after[f"{name}_1_ago"] for name in ("u", "propeller")] == [0, 0]  # as after a start


def test_far_from_the_goal_it_does_not_start(pilot: Pilot) -> None:
    assert decide(pilot, pose=(-90.0, 0.0, 0.0)).stop.startswith("distance")


def test_inputs_at_the_limits_are_good(pilot: Pilot) -> None:
    assert decide(pilot, 9.0).stop == ""
    old = Reading(9.5, AWAY)
    assert decide(pilot, 10.0, pose=old, velocity=(2.0, 0.5, 0.2)).stop == ""
    assert decide(pilot, 11.0, pose=(23.0, -7.1, 1.5)).stop == ""


def test_the_checks_can_be_changed(s3_pilot: Path) -> None:
    pilot = Pilot.load(s3_pilot, checks=Checks(max_age_s=2.0, min_points=0))
    assert decide(pilot, 2.0, cloud=Reading(0.0, CLOUD[:0])).stop == ""


def test_action_values_that_are_not_finite_stop_the_boat(pilot: Pilot) -> None:
    class Overflowing:
        sizes = pilot.networks.sizes

        def q_values(self, observation: np.ndarray) -> np.ndarray:
            return np.full((len(observation), 77), np.inf, np.float32)

        def greedy(self, observation: np.ndarray, q_values: np.ndarray) -> np.ndarray:
            return q_values.argmax(axis=1)

    decision = decide(Pilot(pilot.description, Overflowing(), pilot.goals))
    assert (decision.propeller_n, decision.rudder_rad) == (0.0, 0.0)
    assert decision.stop


def test_clouds_without_names_stop_the_boat(pilot: Pilot) -> None:
    readings = [Reading(1.0, CLOUD)]
    decision = pilot.decide(1.0, Reading(1.0, AWAY), Reading(1.0, REST), readings)  # type: ignore[arg-type]
    assert decision.stop.startswith("clouds")


def test_a_time_that_is_no_number_stops_the_boat(pilot: Pilot) -> None:
    now: Any = np.array([1.0, 2.0])
    clouds = {"bow": Reading(1.0, CLOUD)}
    assert pilot.decide(now, Reading(1.0, AWAY), Reading(1.0, REST), clouds).stop


def test_no_clouds_at_all_stop_the_boat(pilot: Pilot) -> None:
    good = Reading(0.0, AWAY), Reading(0.0, REST)
    assert pilot.decide(0.0, *good, None).stop.startswith("clouds")  # type: ignore[arg-type]
