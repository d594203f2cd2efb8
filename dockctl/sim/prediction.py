"""Predicted motion of one boat under many sequences of commands, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np

from dockctl.compute import compiled
from dockctl.geometry import rotate
from dockctl.sim.actuation import respond
from dockctl.sim.integration import advance, propeller

_rotate = compiled()(rotate)


@compiled()
def predict(
    state: Any,
    wanted: Any,
    response: Any,
    current: Any,
    force: Any,
    coefficients: Any,
    arm_m: float,
    period_s: float,
    substeps: int,
) -> Any:
    """Predict m sequences of k commands from one state.

    Args:
        state: (6,) pose, and velocity relative to the water.
        wanted: (m, k, 2) commands after their delay [N, rad].
        response: (5,) thrust and rudder angle now, propeller lag, rudder rate and astern factor, as in
            `respond`.
        current: (2,) constant, world frame [m/s].
        force: (k, 3) force and moment in each control step, world frame [N, N, N m]; during a step they are
            constant in the body frame, as in the simulator.
        coefficients: (1, 17), as in `integrate`.
        arm_m: of the propeller.
        period_s: control period.
        substeps: of a control period, an even number.

    Returns:
        Poses (m, 2 k, 3) after every half of a control step, and velocities over ground (m, k, 2) [m/s] in
        the body frame after every one.
    """
    sequences, steps, _ = wanted.shape
    poses, velocities = np.empty((sequences, 2 * steps, 3)), np.empty((sequences, steps, 2))
    commands, actual = np.empty((1, substeps, 2)), np.empty((1, substeps, 2))
    tau, states = np.empty((1, substeps, 3)), np.empty((1, substeps + 1, 6))
    eta, nu, part_s = np.empty((1, 3)), np.empty((1, 3)), period_s / substeps
    thrust, angle = np.empty(1), np.empty(1)
    lag, rate, astern = response[2:3], response[3:4], response[4:5]
    for i in range(sequences):
        eta[0], nu[0], thrust[0], angle[0] = state[:3], state[3:], response[0], response[1]
        for k in range(steps):
            commands[0, :] = wanted[i, k]
            respond(commands, thrust, angle, lag, rate, astern, part_s, actual)
            wind = _rotate(force[k, 0], force[k, 1], -eta[0, 2])
            for part in range(substeps):
                surge, sway, yaw = propeller(actual[0, part, 0], actual[0, part, 1], arm_m)
                tau[0, part, 0], tau[0, part, 1] = surge + wind[0], sway + wind[1]
                tau[0, part, 2] = yaw + force[k, 2]
            advance(0, eta, nu, tau, coefficients, part_s, substeps, 0.0, states)
            for half in range(2):
                pose, time_s = states[0, substeps // 2 * (half + 1)], (k + (half + 1) / 2) * period_s
                poses[i, 2 * k + half, 0] = pose[0] + current[0] * time_s
                poses[i, 2 * k + half, 1] = pose[1] + current[1] * time_s
                poses[i, 2 * k + half, 2] = pose[2]
            drift = _rotate(current[0], current[1], -eta[0, 2])
            velocities[i, k, 0], velocities[i, k, 1] = nu[0, 0] + drift[0], nu[0, 1] + drift[1]
    return poses, velocities
