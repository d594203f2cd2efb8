"""Predicted motion of one boat under many sequences of commands, compiled.

Every part of a step is a function with a loop over all sequences, which becomes vector instructions: with
AVX-512 seven times as fast as one sequence after another. In a larger function the compiler cannot tell that
rows do not overlap.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dockctl.compute import compiled
from dockctl.sim.actuation import response
from dockctl.sim.integration import cos_sin, propeller, runge_kutta


@compiled()
def predict(
    state: Any,
    wanted: Any,
    actuators: Any,
    current: Any,
    force: Any,
    own: Any,
    arm_m: float,
    period_s: float,
    substeps: int,
) -> Any:
    """Predict m sequences of k commands from one state.

    Args:
        state: (6,) pose, and velocity relative to the water.
        wanted: (m, k, 2) commands after their delay [N, rad].
        actuators: (5,) thrust and rudder angle now, propeller lag, rudder rate and astern factor, as in
            `response`.
        current: (2,) constant, world frame [m/s].
        force: (k, 3) force and moment in each control step, world frame [N, N, N m]; during a step they are
            constant in the body frame, as in the simulator.
        own: a tuple of the 17 coefficients, in the order of `dockctl.sim.vessel.Coefficients`.
        arm_m: of the propeller.
        period_s: control period.
        substeps: of a control period, an even number.

    Returns:
        Poses (m, 2 k, 3) after every half of a control step, and velocities over ground (m, k, 2) [m/s] in
        the body frame after every one.
    """
    sequences, steps, _ = wanted.shape
    poses, velocities = np.empty((2 * steps, 3, sequences)), np.empty((steps, 2, sequences))
    motion, drift = np.empty((6, sequences)), np.empty((2, sequences))
    commands, actual = np.empty((2, sequences)), np.empty((2, sequences))
    tau, wind = np.empty((3, sequences)), np.empty((3, sequences))
    for row in range(6):
        motion[row] = state[row]
    for row in range(2):
        actual[row] = actuators[row]
    h = period_s / substeps
    for k in range(steps):
        commands[0], commands[1], wind[2] = wanted[:, k, 0], wanted[:, k, 1], force[k, 2]
        _to_body(motion[2], force[k], wind)
        for part in range(substeps):
            _respond(commands, actual, actuators[2:], h, tau)
            _propel(tau, arm_m)
            tau += wind
            _advance(motion, tau, own, h)
            if 2 * (part + 1) % substeps == 0:
                half = 2 * k + 2 * (part + 1) // substeps
                poses[half - 1] = motion[:3]
                for axis in range(2):
                    poses[half - 1, axis] += current[axis] * (half / 2 * period_s)
        _to_body(motion[2], current, drift)
        velocities[k] = motion[3:5] + drift
    return poses.transpose(2, 0, 1), velocities.transpose(2, 0, 1)


@compiled()
def _to_body(heading: Any, vector: Any, body: Any) -> None:
    """Write a vector of the world frame in the body frames of headings (m,) [rad] to two rows of `body`."""
    ahead, port = body[0], body[1]
    x, y = vector[0], vector[1]
    for i in range(len(heading)):
        c, s = cos_sin(heading[i])
        ahead[i], port[i] = c * x + s * y, c * y - s * x


@compiled()
def _respond(commands: Any, actual: Any, given: Any, h: float, tau: Any) -> None:
    """Write mean forces and angles over h seconds to two rows of `tau`, and update the actual ones (2, m)."""
    force, rudder, thrust, angle = commands[0], commands[1], actual[0], actual[1]
    mean, mean_angle = tau[0], tau[1]
    lag_s, rate, astern = given[0], given[1], given[2]
    for i in range(len(force)):
        mean[i], mean_angle[i], thrust[i], angle[i] = response(
            force[i], rudder[i], thrust[i], angle[i], lag_s, rate, astern, h
        )


@compiled()
def _propel(tau: Any, arm_m: float) -> None:
    """Replace forces and angles of propellers, the first two rows, by forces and moment (3, m)."""
    X, Y, N = tau[0], tau[1], tau[2]
    for i in range(len(X)):
        X[i], Y[i], N[i] = propeller(X[i], Y[i], arm_m)


@compiled()
def _advance(motion: Any, tau: Any, own: Any, h: float) -> None:
    """Take a Runge-Kutta step of h seconds with poses and velocities (6, m), in place."""
    x, y, p, u, v, r = motion[0], motion[1], motion[2], motion[3], motion[4], motion[5]
    X, Y, N = tau[0], tau[1], tau[2]
    for i in range(len(x)):
        dx, dy, dp, du, dv, dr = runge_kutta(p[i], u[i], v[i], r[i], (X[i], Y[i], N[i]), own, h, True)
        x[i] += dx
        y[i] += dy
        p[i] += dp
        u[i] += du
        v[i] += dv
        r[i] += dr
