"""Distance to the goal, and when it is reached (thesis eqs. 3.5, 3.6, sections 3.2.3, 4.3)."""

from __future__ import annotations

import numpy as np

from dockctl.geometry import wrap
from dockctl.scenarios.schema import Task, Tolerance
from dockctl.sim.status import Bools, Floats, Ints

TO_INTERMEDIATE, TO_FINAL = 0, 1


def measure(eta: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """Return distance (n,) [m] and heading error (n,) [rad] of poses and goals (n, 3) (eqs. 3.5, 3.6)."""
    offset = eta - goal
    return np.hypot(offset[:, 0], offset[:, 1]), wrap(offset[:, 2])


def final_reached(limit: Tolerance, distance: Floats, heading_error: Floats, speed: Floats) -> Bools:
    """Return whether the final pose is reached: distance and heading < limits, speed <= its limit."""
    inside = (distance < limit.distance_m) & (np.abs(heading_error) < limit.heading)
    return inside & (speed <= limit.speed_mps)


def intermediate_reached(limit: Tolerance, distance: Floats, heading_error: Floats, speed: Floats) -> Bools:
    """Return whether the intermediate pose is reached: distance and heading <= limits, speed < its limit."""
    inside = (distance <= limit.distance_m) & (np.abs(heading_error) <= limit.heading)
    return inside & (speed < limit.speed_mps)


def reached(
    task: Task, phase: Ints, distance: Floats, heading_error: Floats, speed: Floats
) -> tuple[Bools, Bools]:
    """Return whether the intermediate and the final pose are reached, each in its own phase; all (n,)."""
    intermediate = intermediate_reached(task.intermediate_tolerance, distance, heading_error, speed)
    final = final_reached(task.final_tolerance, distance, heading_error, speed)
    return (phase == TO_INTERMEDIATE) & intermediate, (phase == TO_FINAL) & final
