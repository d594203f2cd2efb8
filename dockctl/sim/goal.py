"""Where the goal is, how far, and when it counts as reached (eqs. 3.5, 3.6, sections 3.2.3, 4.3)."""

from __future__ import annotations

import numpy as np

from dockctl.geometry import wrap
from dockctl.scenarios.schema import Task, Tolerance
from dockctl.sim.status import Bools, Floats, Ints

TO_INTERMEDIATE, TO_FINAL = 0, 1


def measure(eta: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """Return delta d (n,) [m] and delta psi (n,) [rad] from goals (n, 3) to poses (n, 3) (eqs. 3.5, 3.6)."""
    offset = eta - goal
    return np.hypot(offset[:, 0], offset[:, 1]), wrap(offset[:, 2])


def final_reached(limit: Tolerance, distance: Floats, heading_error: Floats, speed: Floats) -> Bools:
    """Return who rests at the final pose: distance and heading below their limits, speed at most at its."""
    inside = (distance < limit.distance_m) & (np.abs(heading_error) < limit.heading)
    return inside & (speed <= limit.speed_mps)


def intermediate_reached(limit: Tolerance, distance: Floats, heading_error: Floats, speed: Floats) -> Bools:
    """Return who is at the intermediate pose: distance and heading at most at their limits, speed below."""
    inside = (distance <= limit.distance_m) & (np.abs(heading_error) <= limit.heading)
    return inside & (speed < limit.speed_mps)


def reached(
    task: Task, phase: Ints, distance: Floats, heading_error: Floats, speed: Floats
) -> tuple[Bools, Bools]:
    """Return who reached the intermediate and who the final pose, each only in its own phase; all (n,)."""
    intermediate = intermediate_reached(task.intermediate_tolerance, distance, heading_error, speed)
    final = final_reached(task.final_tolerance, distance, heading_error, speed)
    return (phase == TO_INTERMEDIATE) & intermediate, (phase == TO_FINAL) & final
