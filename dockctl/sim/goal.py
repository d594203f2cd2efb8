"""When a goal is reached (thesis eqs. 3.5, 3.6, sections 3.2.3, 4.3), and the result of a control step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dockctl.errors import DockctlError
from dockctl.geometry import Bools, Floats, Ints, rotate, wrap

TO_INTERMEDIATE, TO_FINAL = 0, 1


class Limit(Protocol):
    """Limits at which a pose is reached: distance [m], heading [rad] and speed [m/s]."""

    @property
    def distance_m(self) -> float: ...
    @property
    def heading(self) -> float: ...
    @property
    def speed_mps(self) -> float: ...


class Limits(Protocol):
    """The limits of both poses; `dockctl.scenarios.schema.Task` implements it."""

    @property
    def intermediate_tolerance(self) -> Limit: ...
    @property
    def final_tolerance(self) -> Limit: ...


def measure(eta: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """Return distance (n,) [m] and heading error (n,) [rad] of poses and goals (n, 3) (eqs. 3.5, 3.6)."""
    offset = eta - goal
    return np.hypot(offset[:, 0], offset[:, 1]), wrap(offset[:, 2])


def bearing(eta: Floats, goal: Floats) -> Floats:
    """Return the direction of the goals (n,) [rad] in the body frame of poses; both (n, 3)."""
    offset = goal - eta
    return wrap(np.arctan2(offset[:, 1], offset[:, 0]) - eta[:, 2])


def offset(eta: Floats, goal: Floats) -> Floats:
    """Return the positions of poses in the frames of goals, ahead and to port, (n, 2) [m]; both (n, 3)."""
    x, y, _ = (eta - goal).T
    return np.column_stack(rotate(x, y, -goal[:, 2]))


def course(eta: Floats, nu: Floats, goal: Floats) -> tuple[Floats, Floats]:
    """Return speed over ground (n,) [m/s], and course relative to the goals' headings (n,) [rad].

    Args:
        eta, goal: (n, 3) poses, world frame.
        nu: (n, 3) velocity over ground, body frame.

    Returns:
        The course is not wrapped.
    """
    u, v = nu[:, 0], nu[:, 1]
    return np.hypot(u, v), eta[:, 2] + np.arctan2(v, u) - goal[:, 2]


def final_reached(limit: Limit, distance: Floats, heading_error: Floats, speed: Floats) -> Bools:
    """Return whether the final pose is reached: distance and heading < limits, speed <= its limit.

    All are (n,), in m, rad and m/s.
    """
    inside = (distance < limit.distance_m) & (np.abs(heading_error) < limit.heading)
    return inside & (speed <= limit.speed_mps)


def intermediate_reached(limit: Limit, distance: Floats, heading_error: Floats, speed: Floats) -> Bools:
    """Return whether the intermediate pose is reached: distance and heading <= limits, speed < its limit.

    All are (n,), in m, rad and m/s.
    """
    inside = (distance <= limit.distance_m) & (np.abs(heading_error) <= limit.heading)
    return inside & (speed < limit.speed_mps)


def reached(
    task: Limits, phase: Ints, distance: Floats, heading_error: Floats, speed: Floats
) -> tuple[Bools, Bools]:
    """Return whether the intermediate and the final pose are reached, each in its own phase; all (n,)."""
    intermediate = intermediate_reached(task.intermediate_tolerance, distance, heading_error, speed)
    final = final_reached(task.final_tolerance, distance, heading_error, speed)
    return (phase == TO_INTERMEDIATE) & intermediate, (phase == TO_FINAL) & final


def _unknown(limit_m: float) -> Floats:
    raise DockctlError("the status of this step has no clearance", code="unavailable")


@dataclass(frozen=True)
class StepStatus:
    """Result of one control step of n boats, relative to the goal of the phase in which the step was taken.

    Shapes are (n,) unless noted.

    Attributes:
        phase: 0 on the way to the intermediate pose, 1 on the way to the final pose.
        distance_m: delta d, from the center of gravity to the goal (eq. 3.5) [m].
        heading_error_rad: delta psi, heading minus the heading of the goal, wrapped to (-pi, pi] (eq. 3.6).
        previous_distance_m, previous_heading_error_rad: the same before the step, relative to the same goal.
        eta: (n, 3) pose after the step, x, y [m] and heading [rad], world frame.
        nu: (n, 3) surge, sway [m/s] and yaw rate [rad/s] after the step.
        command, previous_command: (n, 2) propeller force [N] and rudder angle [rad].
        sector_ranges_m: (n, sectors) range of the nearest return in each sector [m].
        collided, reached_intermediate, reached_final: events; at most one is true for a boat.
        clearance_below: function of a limit [m] that returns the distance between hull and harbor after the
            step, at most the limit, (n,) [m]. The distance is computed only when it is called.
    """

    phase: Ints
    distance_m: Floats
    heading_error_rad: Floats
    previous_distance_m: Floats
    previous_heading_error_rad: Floats
    eta: Floats
    nu: Floats
    command: Floats
    previous_command: Floats
    sector_ranges_m: Floats
    collided: Bools
    reached_intermediate: Bools
    reached_final: Bools
    clearance_below: Callable[[float], Floats] = _unknown

    @property
    def speed_mps(self) -> Floats:
        """Speed over ground, sqrt(u^2 + v^2), (n,) [m/s]."""
        return np.hypot(self.nu[:, 0], self.nu[:, 1])

    @property
    def terminated(self) -> Bools:
        """Whether the step ends the episode, with a collision or at the final pose, (n,)."""
        return self.collided | self.reached_final

    def outcome(self, truncated: Bools) -> NDArray[np.object_]:
        """Return how each episode ended, (n,): "docked", "collision", "timeout", or "" if it continues.

        Args:
            truncated: (n,) whether the episode ends at its step limit.
        """
        outcome = np.full(len(self.phase), "", object)
        outcome[truncated] = "timeout"
        outcome[self.reached_final] = "docked"
        outcome[self.collided] = "collision"
        return outcome
