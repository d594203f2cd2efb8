"""A controller that docks in reverse: it backs along the axis of the berth and slows down near the goal.

dockctl evaluate examples/controller/reverse.py:Reverse --scenario s1
dockctl compare s1 examples/controller/reverse.py:Reverse --scenario s1
"""

from __future__ import annotations

from typing import Any

import numpy as np

MAX_SPEED_MPS = 0.35
SLOWING_PER_S = 0.1  # speed per meter left
LOOKAHEAD_M = 3.0  # distance over which a cross-track error is removed
TURNING_PER_S = 0.3  # yaw rate per heading error


class Reverse:
    """Selects the action that best balances the damping at the wanted surge speed and yaw rate."""

    def __init__(self, scenario: Any) -> None:
        self.vessel = scenario.vessel
        actions = np.arange(scenario.actions.space(self.vessel).n)
        force_n, angle_rad = scenario.actions.commands(actions, self.vessel).T
        self.surge_n = force_n * np.cos(angle_rad)
        self.yaw_n = force_n * np.sin(angle_rad)  # moment divided by the propeller arm

    def reset(self, rows: np.ndarray, info: dict[str, Any]) -> None:
        """Do nothing: the controller keeps no state."""

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        """Return an action (n,) for each boat."""
        goal, vessel = info["goal"], self.vessel
        dx, dy = (info["pose"] - goal)[:, :2].T
        along_m = dx * np.cos(goal[:, 2]) + dy * np.sin(goal[:, 2])  # ahead of the goal
        across_m = dy * np.cos(goal[:, 2]) - dx * np.sin(goal[:, 2])  # to port of its axis
        # A bow to port moves a boat that goes astern to starboard.
        turn = np.arctan(across_m / LOOKAHEAD_M) - info["heading_error_rad"]
        u = -np.clip(SLOWING_PER_S * along_m, -MAX_SPEED_MPS, MAX_SPEED_MPS)
        surge_n = (vessel.X_u_kgps + vessel.X_uu_kgpm * np.abs(u)) * u
        yaw_n = vessel.N_r_kgm2ps * TURNING_PER_S * turn / vessel.propeller_arm_m
        misfit = (self.surge_n - surge_n[:, None]) ** 2 + (self.yaw_n - yaw_n[:, None]) ** 2
        return misfit.argmin(axis=1)
