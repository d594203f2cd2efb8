"""Equations of motion of a 3-DOF vessel in the plane (thesis eqs. 2.5-2.23), for n boats at once.

The matrices follow the thesis and are the reference implementation. `_integrate` is the same arithmetic,
written out by element for speed; tests compare the two.

The yaw mode of the thesis' boat has its pole at -9.43 1/s. A single Runge-Kutta step over the control period
of 0.5 s would be unstable (the limit is 0.295 s), so the integration uses substeps.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dockctl.compute import compiled
from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Vessel


def coriolis(vessel: Vessel, nu: Floats) -> Floats:
    """Return C(nu) (n, 3, 3), rigid body and added mass (eq. 2.18), skew-symmetric."""
    u, v, r = nu.T
    matrix = np.zeros((len(nu), 3, 3))
    matrix[:, 0, 1] = -vessel.mass_kg * r
    matrix[:, 0, 2] = vessel.Y_vdot_kg * v + vessel.Y_rdot_kgm * r
    matrix[:, 1, 2] = -vessel.X_udot_kg * u
    return matrix - matrix.transpose(0, 2, 1)


def damping(vessel: Vessel, nu: Floats) -> Floats:
    """Return D(nu) (n, 3, 3), linear and quadratic damping (eq. 2.22)."""
    u, v, r = np.abs(nu).T
    matrix = np.zeros((len(nu), 3, 3))
    matrix[:, 0, 0] = vessel.X_u_kgps + vessel.X_uu_kgpm * u
    matrix[:, 1, 1] = vessel.Y_v_kgps + vessel.Y_vv_kgpm * v
    matrix[:, 1, 2] = vessel.Y_r_kgmps
    matrix[:, 2, 1] = vessel.N_v_kgmps
    matrix[:, 2, 2] = vessel.N_r_kgm2ps + vessel.N_rr_kgm2 * r
    return matrix


def rotation(heading: Floats) -> Floats:
    """Return R(psi) (n, 3, 3), from the body frame to the world frame (eq. 2.9); heading (n,) [rad]."""
    matrix = np.zeros((len(heading), 3, 3))
    matrix[:, 0, 0] = matrix[:, 1, 1] = np.cos(heading)
    matrix[:, 1, 0] = np.sin(heading)
    matrix[:, 0, 1] = -matrix[:, 1, 0]
    matrix[:, 2, 2] = 1.0
    return matrix


class VesselModel:
    """The equations of motion of one vessel; the result of a row does not depend on the other rows."""

    def __init__(self, vessel: Vessel) -> None:
        self.vessel = vessel
        self._inverse_inertia: Floats = np.linalg.inv(vessel.inertia).astype(float)
        self.coefficients = coefficients(vessel)[None]

    @property
    def command_limit(self) -> Floats:
        """Maximum propeller force [N] and rudder angle [rad], (2,)."""
        return np.array([self.vessel.max_propeller_n, np.radians(self.vessel.max_rudder_deg)])

    def tau(self, command: Floats) -> Floats:
        """Return surge force, sway force and yaw moment (..., 3) [N, N, N m] of a command (eq. 2.23).

        Args:
            command: (..., 2) propeller force [N] and rudder angle [rad].
        """
        force, rudder = command[..., 0], command[..., 1]
        sideways = force * np.sin(rudder)
        surge = force * np.cos(rudder)
        return np.stack([surge, -sideways, self.vessel.propeller_arm_m * sideways], axis=-1)

    def nu_dot(self, nu: Floats, tau: Floats) -> Floats:
        """Return nu' (n, 3) in the body frame, from M nu' = tau - C(nu) nu - D(nu) nu (eq. 2.5)."""
        resistance = (coriolis(self.vessel, nu) + damping(self.vessel, nu)) @ nu[:, :, None]
        return (tau - resistance[:, :, 0]) @ self._inverse_inertia.T

    def eta_dot(self, eta: Floats, nu: Floats) -> Floats:
        """Return the velocity (n, 3) in the world frame, R(psi) nu (eq. 2.8)."""
        return (rotation(eta[:, 2]) @ nu[:, :, None])[:, :, 0]

    def step(self, eta: Floats, nu: Floats, command: Floats) -> tuple[Floats, Floats]:
        """Return pose and velocity (n, 3) one control period later, with a constant command.

        Args:
            eta: (n, 3) x, y [m] and heading [rad].
            nu: (n, 3) u, v [m/s] and r [rad/s].
            command: (n, 2) propeller force [N] and rudder angle [rad].
        """
        after, velocity, _ = self.step_and_travel(eta, nu, self.tau(command)[:, None])
        return after, velocity

    def step_and_travel(
        self, eta: Floats, nu: Floats, tau: Floats, coefficients: Floats | None = None
    ) -> tuple[Floats, Floats, Floats]:
        """Return pose and velocity (n, 3) one control period later, and the way of the hull (n,) [m].

        Args:
            eta, nu: as in `step`.
            tau: (n, k, 3) surge force, sway force and yaw moment [N, N, N m], in equal parts of the period;
                k divides the number of substeps.
            coefficients: (n, 17) of each boat, as `coefficients` returns them; by default of the vessel.

        Returns:
            the third one is a bound of the way of any point of the hull.
        """
        return self._integrate(eta, nu, tau, coefficients, np.empty((0, 0, 6)))

    def path(self, eta: Floats, nu: Floats, tau: Floats, coefficients: Floats | None = None) -> Floats:
        """Return pose and velocity (n, substeps + 1, 6) at the ends of the substeps of `step_and_travel`."""
        states = np.empty((len(eta), self.vessel.substeps + 1, 6))
        self._integrate(eta, nu, tau, coefficients, states)
        return states

    def _integrate(
        self, eta: Floats, nu: Floats, tau: Floats, coefficients: Floats | None, states: Floats
    ) -> tuple[Floats, Floats, Floats]:
        period, substeps = self.vessel.control_period_s, self.vessel.substeps
        own = self.coefficients if coefficients is None else coefficients
        after: tuple[Floats, Floats, Floats] = _integrate(
            eta, nu, tau, own, period / substeps, substeps, self.vessel.hull.reach_m, states
        )
        return after

    def step_reference(self, eta: Floats, nu: Floats, command: Floats) -> tuple[Floats, Floats]:
        """Reference implementation of `step`: classical Runge-Kutta with the matrices above."""
        tau, h = self.tau(command), self.vessel.control_period_s / self.vessel.substeps

        def rate(state: Floats) -> Floats:
            eta, nu = state[:, :3], state[:, 3:]
            return np.hstack([self.eta_dot(eta, nu), self.nu_dot(nu, tau)])

        state = np.hstack([eta, nu])
        for _ in range(self.vessel.substeps):
            k1 = rate(state)
            k2 = rate(state + h / 2 * k1)
            k3 = rate(state + h / 2 * k2)
            k4 = rate(state + h * k3)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return state[:, :3], state[:, 3:]


def coefficients(vessel: Vessel) -> Floats:
    """Return the numbers (17,) of the equations of motion in the order in which `_rate` unpacks them."""
    inverse = np.linalg.inv(vessel.inertia)
    return np.array(
        [
            *(inverse[index] for index in ((0, 0), (1, 1), (1, 2), (2, 1), (2, 2))),
            *(vessel.mass_kg, vessel.X_udot_kg, vessel.Y_vdot_kg, vessel.Y_rdot_kgm),
            *(vessel.X_u_kgps, vessel.X_uu_kgpm, vessel.Y_v_kgps, vessel.Y_vv_kgpm),
            *(vessel.Y_r_kgmps, vessel.N_v_kgmps, vessel.N_r_kgm2ps, vessel.N_rr_kgm2),
        ]
    )


@compiled(inline="always")
def _rate(psi: float, u: float, v: float, r: float, tau: Any, coefficients: Any) -> Any:
    """Return the time derivatives of x, y, psi, u, v, r of one boat."""
    i00, i11, i12, i21, i22, m, Xud, Yvd, Yrd, Xu, Xuu, Yv, Yvv, Yr, Nv, Nr, Nrr = coefficients
    added = Yvd * v + Yrd * r
    X = tau[0] + m * r * v - added * r - (Xu + Xuu * abs(u)) * u
    Y = tau[1] - m * r * u + Xud * u * r - (Yv + Yvv * abs(v)) * v - Yr * r
    N = tau[2] + added * u - Xud * u * v - Nv * v - (Nr + Nrr * abs(r)) * r
    c, s = np.cos(psi), np.sin(psi)
    return c * u - s * v, s * u + c * v, r, i00 * X, i11 * Y + i12 * N, i21 * Y + i22 * N


@compiled(inline="always")
def _write(row: Any, values: Any) -> None:
    """Assign each value; for `row[:] = values`, numba would compile the message of an error, for seconds."""
    for i, value in enumerate(values):
        row[i] = value


@compiled()
def _integrate(
    eta: Any, nu: Any, tau: Any, coefficients: Any, h: float, substeps: int, reach: float, states: Any
) -> Any:
    """Take `substeps` Runge-Kutta steps of h seconds for every row; returns new arrays.

    `tau` is (n, k, 3), one row for every substeps / k steps; `coefficients` are (n, 17), or (1, 17) for all
    boats. The third result sums the motion of the outermost point, at `reach`. All states are written to
    `states` (n, substeps + 1, 6), unless it is empty.
    """
    eta, nu, travel = eta.copy(), nu.copy(), np.zeros(len(eta))
    a, b = h / 2, h / 6
    for i in range(len(eta)):
        x, y, p = eta[i]
        u, v, r = nu[i]
        c = coefficients[min(i, len(coefficients) - 1)]
        for j in range(substeps):
            part = j * tau.shape[1] // substeps
            f = (tau[i, part, 0], tau[i, part, 1], tau[i, part, 2])
            if len(states):
                _write(states[i, j], (x, y, p, u, v, r))
            x0, y0, p0 = x, y, p
            x1, y1, p1, u1, v1, r1 = _rate(p, u, v, r, f, c)
            x2, y2, p2, u2, v2, r2 = _rate(p + a * p1, u + a * u1, v + a * v1, r + a * r1, f, c)
            x3, y3, p3, u3, v3, r3 = _rate(p + a * p2, u + a * u2, v + a * v2, r + a * r2, f, c)
            x4, y4, p4, u4, v4, r4 = _rate(p + h * p3, u + h * u3, v + h * v3, r + h * r3, f, c)
            x += b * (x1 + 2 * x2 + 2 * x3 + x4)
            y += b * (y1 + 2 * y2 + 2 * y3 + y4)
            p += b * (p1 + 2 * p2 + 2 * p3 + p4)
            u += b * (u1 + 2 * u2 + 2 * u3 + u4)
            v += b * (v1 + 2 * v2 + 2 * v3 + v4)
            r += b * (r1 + 2 * r2 + 2 * r3 + r4)
            travel[i] += math.hypot(x - x0, y - y0) + reach * abs(p - p0)
        eta[i, 0], eta[i, 1], eta[i, 2] = x, y, p
        nu[i, 0], nu[i, 1], nu[i, 2] = u, v, r
        if len(states):
            _write(states[i, substeps], (x, y, p, u, v, r))
    return eta, nu, travel
