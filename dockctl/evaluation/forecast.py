"""Prediction of the motion of boats in wind and current, with what is estimated from their sensors."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
from pydantic import ValidationError

from dockctl.geometry import Bools, Floats, Ints, rotate
from dockctl.scenarios.vessel import Vessel
from dockctl.sim.simulator import Simulator
from dockctl.sim.vessel import VesselModel

AVERAGED_S = 20.0
"""Time constant with which current and wind are averaged; the first values are plain means."""
SURGE_WEIGHT = 0.04
"""Weight of the squared error of surge [m/s], relative to that of yaw rate [rad/s]: both are noisy."""


class Forecast:
    """Estimates what acts on n boats, and predicts their poses with it.

    The current is the difference of the velocities over ground and through the water, and the force of the
    wind that at the measured wind; both are averaged. The delay of the actuators is no or one control step,
    whichever has predicted surge and yaw rate better so far in the episode. Masses and damping are the
    vessel's own.

    Args:
        simulator: of the n boats; its sensors measure.

    Attributes:
        delayed: (n,) whether commands take effect one control step later.
    """

    def __init__(self, simulator: Simulator) -> None:
        vessel, boats = simulator.vessel.vessel, len(simulator.eta)
        self._simulator, self._period_s = simulator, vessel.control_period_s
        self._vessel = VesselModel(_with_fewest_substeps(vessel))
        self._current, self._force = np.zeros((boats, 2)), np.zeros((boats, 3))  # world frame
        self._averaged = np.zeros(boats, np.int64)
        self._state = np.full((boats, 6), np.nan)
        self._commands = np.zeros((2, boats, 2))  # latest first
        self._error = np.zeros((2, boats))
        self.delayed: Bools = np.zeros(boats, bool)

    def reset(self, rows: Ints) -> None:
        """Forget the episodes of the boats `rows` (k,)."""
        self._averaged[rows], self._state[rows] = 0, np.nan
        self._commands[:, rows], self._error[:, rows] = 0.0, 0.0

    def measure(self, eta: Floats, nu: Floats) -> None:
        """Update the estimates with measured poses and velocities over ground (n, 3)."""
        simulator = self._simulator
        own, heading = simulator.nu.copy(), simulator.eta[:, 2]
        through_water = own[:, :2] - _turned(simulator.current(), -heading)
        force = simulator.disturbances.sum("force", 3, simulator.eta.copy(), own)
        share = np.maximum(1 / (self._averaged + 1), self._period_s / AVERAGED_S)[:, None]
        self._current += share * (_turned(nu[:, :2] - through_water, eta[:, 2]) - self._current)
        self._force += share * (_turned(force, heading) - self._force)
        self._averaged += 1
        self._compare(nu)
        self._state = np.hstack([eta, nu])

    def command(self, commands: Floats) -> None:
        """Record the commands (n, 2) [N, rad] of the next control step."""
        self._commands = np.stack([commands, self._commands[0]])

    def poses(self, rows: Ints, commands: Floats) -> tuple[Floats, Floats]:
        """Predict from the latest measurement where boats will be, and how fast.

        Args:
            rows: (m,) a boat for each prediction; it may occur more than once.
            commands: (m, k, 2) of the next k control steps [N, rad].

        Returns:
            Poses (m, 2 k, 3) after every half of a control step, and velocities over ground (m, k, 2) [m/s]
            in the body frame after every one.
        """
        late = np.concatenate([self._commands[0, rows][:, None], commands[:, :-1]], axis=1)
        commands = np.where(self.delayed[rows][:, None, None], late, commands)
        state, poses, velocities = self._state[rows], [], []
        for command in commands.swapaxes(0, 1):
            halfway, state = self._step(state, command, self._current[rows], self._force[rows])
            poses += [halfway, state[:, :3]]
            velocities.append(state[:, 3:5])
        return np.stack(poses, axis=1), np.stack(velocities, axis=1)

    def _compare(self, nu: Floats) -> None:
        """Compare velocities (n, 3) with those predicted for each delay from the measurement before."""
        known = np.flatnonzero(~np.isnan(self._state[:, 0]))
        if len(known):
            start, current, force = self._state[known], self._current[known], self._force[known]
            for error, commands in zip(self._error, self._commands, strict=True):
                _, after = self._step(start, commands[known], current, force)
                surge, _, yaw = (nu[known] - after[:, 3:]).T
                error[known] += SURGE_WEIGHT * surge**2 + yaw**2
        self.delayed = self._error[1] < self._error[0]

    def _step(self, state: Floats, command: Floats, current: Floats, force: Floats) -> tuple[Floats, Floats]:
        """Return the poses (m, 3) after half a control step, and the states (m, 6) at its end.

        States are poses and velocities over ground. As in the simulator, the equations of motion hold for the
        velocity relative to the water, and the force of the wind is constant in the body frame.
        """
        eta, nu = state[:, :3].copy(), state[:, 3:].copy()
        nu[:, :2] -= _turned(current, -eta[:, 2])
        tau = self._vessel.tau(command) + _turned(force, -eta[:, 2])
        path = self._vessel.path(eta, nu, tau[:, None])
        halfway, state = path[:, path.shape[1] // 2, :3].copy(), path[:, -1].copy()
        halfway[:, :2] += current * self._period_s / 2
        state[:, :2] += current * self._period_s
        state[:, 3:5] += _turned(current, -state[:, 2])
        return halfway, state


def _with_fewest_substeps(vessel: Vessel) -> Vessel:
    """Return the vessel with the smallest even, stable number of substeps, for poses at half-periods."""
    for substeps in range(2, 2 * vessel.substeps, 2):
        with suppress(ValidationError):
            return Vessel.model_validate({**dict(vessel), "substeps": substeps})
    return vessel.model_copy(update={"substeps": 2 * vessel.substeps})


def _turned(vectors: Floats, angle: Floats) -> Floats:
    """Return vectors (n, 2 or more), whose first two components are horizontal, rotated by angles (n,)."""
    return np.column_stack([*rotate(vectors[:, 0], vectors[:, 1], angle), vectors[:, 2:]])
