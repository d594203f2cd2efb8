"""Result of one control step for every boat: the input of the reward terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class StepStatus:
    """One control step of n boats, relative to the goal of the phase in which the step was made.

    Shapes are (n,) unless noted.

    Attributes:
        phase: 0 on the way to the intermediate pose, 1 on the way to the final pose.
        distance_m: delta d, from the center of gravity to the goal (eq. 3.5) [m].
        heading_error_rad: delta psi, heading minus the heading of the goal, wrapped to (-pi, pi] (eq. 3.6).
        previous_distance_m, previous_heading_error_rad: the same before the step, relative to the same goal.
        nu: (n, 3) surge, sway [m/s] and yaw rate [rad/s] after the step.
        command, previous_command: (n, 2) propeller force [N] and rudder angle [rad].
        sector_ranges_m: (n, sectors) range of the nearest return in each sector [m].
        collided, reached_intermediate, reached_final: events; at most one is true for a boat.
    """

    phase: Ints
    distance_m: Floats
    heading_error_rad: Floats
    previous_distance_m: Floats
    previous_heading_error_rad: Floats
    nu: Floats
    command: Floats
    previous_command: Floats
    sector_ranges_m: Floats
    collided: Bools
    reached_intermediate: Bools
    reached_final: Bools

    @property
    def speed_mps(self) -> Floats:
        """Speed over ground, sqrt(u^2 + v^2), (n,) [m/s]."""
        return np.hypot(self.nu[:, 0], self.nu[:, 1])
