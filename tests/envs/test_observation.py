"""The observation against values computed by hand: order, scaling, bounds, clipping."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.envs.observation import Columns, ObservationEncoder, View, blank_view, observation_part
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, InputError
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import ObservationPart
from tests.sim.worlds import walled

S1, S3 = load("s1").scenario, load("s3").scenario
VIEW = View(
    phase=np.array([1]),
    distance_m=np.array([16.0]),
    heading_error_rad=np.array([-0.35]),
    eta=np.array([[20.0, 2.0, math.pi / 2]]),
    goal=np.array([[36.0, 2.0, math.pi]]),
    nu=np.array([[0.2, -0.05, 0.01]]),
    command=np.array([[-20.0, math.radians(10)]]),
    command_limit=np.array([50.0, math.radians(30)]),
    sector_ranges_m=np.array([[5.0, 10.0, 20.0, 21.0, 100.0, 1.0, 2.0, 3.0]]),
    apparent_wind=np.array([[-2.5, 1.0]]),
    through_water=np.array([[0.3, -0.02]]),
)
RANGES = [0.5, 1.0, 2.0, 2.0, 2.0, 0.1, 0.2, 0.3]


def encoder(*parts: Any) -> ObservationEncoder:
    return ObservationEncoder([ObservationPart.model_validate(part) for part in parts], sectors=8)


def test_scenario_3_observes_16_numbers_in_the_order_of_equation_3_12() -> None:
    encode = ObservationEncoder(S3.observation, sectors=8)
    observation = encode(VIEW)
    assert observation.dtype == np.float32
    assert observation[0] == pytest.approx([1, 1.6, -0.35, 0.5, -0.5, 0.25, -0.4, 1 / 3, *RANGES], rel=1e-6)
    assert encode.names[:8] == ("phase", "distance", "heading_error", "u", "v", "r", "propeller", "rudder")
    assert encode.names[8:] == tuple(f"range_{k}" for k in range(1, 9))


def test_scenario_1_observes_15() -> None:
    encode = ObservationEncoder(S1.observation, sectors=8)
    assert encode.names[0] == "distance"
    assert encode.space.shape == (15,)


def test_bounds_are_those_of_the_data_sheet() -> None:
    space = ObservationEncoder(S3.observation, sectors=8).space
    pi = np.float32(math.pi)
    assert space.low.tolist() == [0, 0, -pi, -5, -5, -5, -1, -1] + [0] * 8
    assert space.high.tolist() == [1, 10, pi, 5, 5, 5, 1, 1] + [2] * 8


def test_the_scenario_determines_the_order() -> None:
    assert encoder("lidar", "phase").names == (*(f"range_{k}" for k in range(1, 9)), "phase")


def test_parameters_scale_and_cap() -> None:
    observation = encoder({"lidar": {"cap_m": 4, "scale_m": 2}}, {"distance": {"scale_m": 20, "cap_m": 10}})(
        VIEW
    )
    assert observation[0].tolist() == [2, 2, 2, 2, 2, 0.5, 1, 1.5, 0.5]


def test_proximity_is_the_inverse_of_the_range_up_to_one() -> None:
    view = replace(VIEW, sector_ranges_m=np.array([[0.5, 1, 2, 3, 4, 8, 100, 1.5]]))
    expected = [1, 1, 1, 1, 3 / 4, 3 / 8, 0.03, 1]
    assert encoder({"proximity": {"full_m": 3}})(view)[0] == pytest.approx(expected)


def test_the_bearing_is_in_the_body_frame() -> None:
    """Heading 90 degrees, goal at 0 degrees: to starboard."""
    assert encoder("bearing")(VIEW)[0] == pytest.approx([-1, 0], abs=1e-7)
    assert encoder("bearing")(replace(VIEW, eta=np.array([[20.0, 2.0, 0.0]])))[0] == pytest.approx([0, 1])


def test_the_offset_is_in_the_frame_of_the_goal() -> None:
    """The goal heads 180 degrees; the boat is 1 m south and 6 m west of it, then out of bounds."""
    near = replace(VIEW, eta=np.array([[30.0, 1.0, 0.3]]))
    assert encoder("offset")(near)[0] == pytest.approx([6 / 2, 1 / 2])
    assert encoder({"offset": {"scale_m": 4, "cap_m": 8}})(VIEW)[0] == pytest.approx([2, 0], abs=1e-6)


numbers = st.floats(-1e6, 1e6)


@pytest.mark.slow
@given(st.lists(numbers, min_size=15, max_size=15), st.sampled_from([0, 1]))
def test_every_view_is_within_the_bounds(values: Sequence[float], phase: int) -> None:
    x = np.array([values])
    view = View(
        phase=np.array([phase]),
        distance_m=abs(x[:, 0]),
        heading_error_rad=np.clip(x[:, 1], -math.pi, math.pi),
        eta=x[:, :3],
        goal=x[:, 3:6],
        nu=x[:, 2:5],
        command=x[:, 5:7],
        command_limit=VIEW.command_limit,
        sector_ranges_m=abs(x[:, 7:15]),
        apparent_wind=x[:, 3:5],
        through_water=x[:, 5:7],
    )
    encode = encoder(
        "phase", "distance", "heading_error", "velocity", "command", "lidar", "bearing", "offset"
    )
    assert encode.space.contains(encode(view)[0])


def test_wrong_names_are_rejected() -> None:
    with pytest.raises(DockctlError, check=lambda error: error.suggestion == "lidar"):
        encoder("lydar")
    with pytest.raises(DockctlError, check=lambda error: error.suggestion == "cap_m"):
        encoder({"lidar": {"cap": 3}})


def test_bounds_that_are_not_in_order_are_rejected() -> None:
    """A policy's card, which is no scenario, may have such a parameter."""
    with pytest.raises(DockctlError) as caught:
        ObservationEncoder([ObservationPart(part="lidar", params={"cap_m": -1})], 8)
    assert caught.value.code == "out_of_range"
    assert "lidar" in str(caught.value)


def test_parts_of_a_wrong_shape_are_rejected() -> None:
    @observation_part("flat")
    def flat(view: View) -> Columns:
        return Columns(["speed"], view.nu[:, 0], -1, 1)

    @observation_part("single_row")
    def single_row(view: View) -> Columns:
        return Columns(["u", "v", "r"], view.nu[:1], -1, 1)

    @observation_part("unbounded")
    def unbounded(view: View) -> Columns:
        return Columns(["u", "v", "r"], view.nu, [-1, -1], 1)

    for part in ("flat", "single_row", "unbounded"):
        with pytest.raises(DockctlError, match=f"'{part}'") as caught:
            encoder(part, "phase")
        assert caught.value.code == "plugin"


@pytest.mark.parametrize(
    "later",
    [lambda nu: nu[:, :1], lambda nu: nu[0, :2], lambda nu: nu[:1, :2]],
    ids=["columns", "flat", "row"],
)
def test_a_part_whose_shape_changes_is_an_error(later: Callable[[Any], Any]) -> None:
    @observation_part("changing")
    def changing(view: View) -> Columns:
        return Columns(["u", "v"], later(view.nu) if view.phase.any() else view.nu[:, :2], -1, 1)

    observe = encoder("changing", "phase")
    view = blank_view(8)
    observe(view)
    with pytest.raises(DockctlError, match="'changing' returned shape"):
        observe(replace(view, phase=view.phase + 1))


def test_apparent_wind_and_course() -> None:
    encode = encoder("apparent_wind", "course")
    assert encode.names == ("wind_ahead", "wind_port", "speed", "course_sin", "course_cos")
    # the boat heads 90 degrees, with 0.2 m/s ahead and 0.05 m/s to starboard; the goal heads 180 degrees
    speed, drift = math.hypot(0.2, 0.05), math.atan2(-0.05, 0.2)
    course = math.pi / 2 + drift - math.pi
    expected = [-0.5, 0.2, speed / 0.4, math.sin(course), math.cos(course)]
    assert encode(VIEW)[0] == pytest.approx(expected, rel=1e-6)


def test_speed_through_the_water() -> None:
    """A boat that drifts with the water has none; without a current it is the speed over ground."""
    assert encoder("through_water")(VIEW)[0] == pytest.approx([0.75, -0.2], rel=1e-6)
    current = {"current": {"speed_mps": 0.3, "direction_deg": 90}}
    for conditions in ({}, current):
        loaded = load("s1", overrides=[f"conditions={conditions}", "observation=[velocity, through_water]"])
        env = DockingVectorEnv(loaded, 1, autoreset_mode="Disabled", worlds=[walled()])
        env.reset(seed=0, options={"poses": np.array([[20.0, 2.0, math.pi / 2]])})
        observation, *_ = env.step(np.array([38]))
        u, v, _, u_water, v_water = observation[0] * [0.4, 0.1, 0.04, 0.4, 0.1]
        heading = env.simulator.eta[0, 2]
        east, north = (0.0, 0.3) if conditions else (0.0, 0.0)
        along = east * math.cos(heading) + north * math.sin(heading)
        to_port = -east * math.sin(heading) + north * math.cos(heading)
        assert (u_water, v_water) == pytest.approx((u - along, v - to_port), abs=1e-6)


def test_history_is_what_was_observed_before() -> None:
    parts = [*S1.observation, ObservationPart(part="history", params={"steps": 3, "parts": ["velocity"]})]
    scenario = S1.model_copy(update={"observation": tuple(parts)})
    env = DockingVectorEnv(scenario, 2, autoreset_mode="Disabled", worlds=[walled()])
    observation, _ = env.reset(seed=3)
    velocity = [i for i, name in enumerate(env.observation_names) if name in ("u", "v", "r")]
    past = [[env.observation_names.index(f"{name}_{age}_ago") for name in "uvr"] for age in (1, 2, 3)]
    seen = [observation[:, velocity]] * 4
    rng = np.random.default_rng(0)
    for step in range(12):
        if step == 6:  # the history of the other boat goes on
            observation, _ = env.reset(options={"reset_mask": np.array([True, False])})
            seen = [np.stack([observation[0, velocity], each[1]]) for each in seen]
        for age in range(3):
            assert np.array_equal(observation[:, past[age]], seen[age + 1])
        observation, *_ = env.step(rng.integers(77, size=2))
        seen = [observation[:, velocity], *seen[:3]]


def test_a_part_that_the_history_does_not_know_has_its_place(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("extends: s1\nobservation: [{history: {parts: [wind]}}]\n")
    with pytest.raises(InputError) as caught:
        load(file)
    (problem,) = caught.value.problems
    assert problem.line == 2
