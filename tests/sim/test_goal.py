"""Distances, and the limits of the tolerances to the last bit."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from dockctl.scenarios.loader import load
from dockctl.sim.goal import StepStatus, final_reached, intermediate_reached, measure, reached

TASK = load("s3").scenario.task
PI = math.pi


def just_below(value: float) -> float:
    return float(np.nextafter(value, -math.inf))


def just_above(value: float) -> float:
    return float(np.nextafter(value, math.inf))


def test_distance_and_heading_error_by_hand() -> None:
    eta = np.array([[20.0, 2.0, math.radians(160)], [36.0, 0.0, math.radians(-170)], [33.0, -4.0, 3 * PI]])
    goal = np.tile([36.0, 0.0, PI], (3, 1))
    distance, error = measure(eta, goal)
    assert distance == pytest.approx([math.sqrt(260), 0, 5])
    assert np.degrees(error) == pytest.approx([-20, 10, 0], abs=1e-9)


FINAL = TASK.final_tolerance  # 1 m, 0.07 rad, 0.1 m/s
FINAL_EDGES = [
    (0.0, 0.0, 0.0, True),
    (just_below(1.0), just_below(0.07), 0.1, True),
    (just_below(1.0), -just_below(0.07), 0.1, True),
    (1.0, 0.0, 0.0, False),
    (0.0, 0.07, 0.0, False),
    (0.0, -0.07, 0.0, False),
    (0.0, 0.0, just_above(0.1), False),
]
INTERMEDIATE_EDGES = [
    (0.0, 0.0, 0.0, True),
    (1.5, math.radians(5), just_below(0.1), True),
    (1.5, -math.radians(5), just_below(0.1), True),
    (just_above(1.5), 0.0, 0.0, False),
    (0.0, just_above(math.radians(5)), 0.0, False),
    (0.0, just_below(-math.radians(5)), 0.0, False),
    (0.0, 0.0, 0.1, False),
]


@pytest.mark.parametrize(("distance", "error", "speed", "holds"), FINAL_EDGES)
def test_limits_of_the_final_pose(distance: float, error: float, speed: float, holds: bool) -> None:
    assert final_reached(FINAL, *map(np.array, ([distance], [error], [speed])))[0] == holds


@pytest.mark.parametrize(("distance", "error", "speed", "holds"), INTERMEDIATE_EDGES)
def test_limits_of_the_intermediate_pose(distance: float, error: float, speed: float, holds: bool) -> None:
    limit = TASK.intermediate_tolerance
    assert intermediate_reached(limit, *map(np.array, ([distance], [error], [speed])))[0] == holds


def test_each_pose_counts_in_its_own_phase_only() -> None:
    zeros = np.zeros(2)
    intermediate, final = reached(TASK, np.array([0, 1]), zeros, zeros, zeros)
    assert intermediate.tolist() == [True, False]
    assert final.tolist() == [False, True]


def test_outcome_of_an_episode() -> None:
    """A collision or the final pose in the last step is not a timeout; the intermediate pose ends nothing."""
    values: dict[str, Any] = {field.name: np.zeros(5) for field in fields(StepStatus)}
    collided, final, intermediate, truncated = np.eye(4, 5, dtype=bool)
    values |= {"collided": collided, "reached_final": final, "reached_intermediate": intermediate}
    status = StepStatus(**values)
    assert status.terminated.tolist() == [True, True, False, False, False]
    assert status.outcome(truncated).tolist() == ["collision", "docked", "", "timeout", ""]
    assert status.outcome(np.full(5, True)).tolist() == ["collision", "docked", *["timeout"] * 3]
