"""Equations of motion of a 3-DOF vessel in the plane (thesis eqs. 2.5-2.23), for n boats at once.

The matrices follow the thesis and are the reference implementation. `dockctl.sim.integration` is the same
arithmetic, written out by element for speed; tests compare the two.

The yaw mode of the thesis's boat has its pole at -9.43 1/s. A single Runge-Kutta step over the control period
of 0.5 s would be unstable (the limit is 0.295 s), so the integration uses substeps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Vessel

NONZERO = ((0, 0), (1, 1), (1, 2), (2, 1), (2, 2))
"""Elements of the inverse of the inertia matrix that are not zero."""


class Coefficients(NamedTuple):
    """Coefficients of the equations of motion of n vessels, (n,) each; or of one, for any number of boats.

    Attributes:
        i00, i11, i12, i21, i22: elements of the inverse of the inertia matrix; the others are zero.
        mass_kg, ...: as in `Vessel`.
    """

    i00: Floats
    i11: Floats
    i12: Floats
    i21: Floats
    i22: Floats
    mass_kg: Floats
    X_udot_kg: Floats
    Y_vdot_kg: Floats
    Y_rdot_kgm: Floats
    X_u_kgps: Floats
    X_uu_kgpm: Floats
    Y_v_kgps: Floats
    Y_vv_kgpm: Floats
    Y_r_kgmps: Floats
    N_v_kgmps: Floats
    N_r_kgm2ps: Floats
    N_rr_kgm2: Floats


def coriolis(vessel: Vessel | Coefficients, nu: Floats) -> Floats:
    """Return C(nu) (n, 3, 3), rigid body and added mass (eq. 2.18), skew-symmetric."""
    u, v, r = nu.T
    matrix = np.zeros((len(nu), 3, 3))
    matrix[:, 0, 1] = -vessel.mass_kg * r
    matrix[:, 0, 2] = vessel.Y_vdot_kg * v + vessel.Y_rdot_kgm * r
    matrix[:, 1, 2] = -vessel.X_udot_kg * u
    return matrix - matrix.transpose(0, 2, 1)


def damping(vessel: Vessel | Coefficients, nu: Floats) -> Floats:
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
        self.coefficients = coefficients(vessel)[None]

    @property
    def command_limit(self) -> Floats:
        """Maximum propeller force [N] and rudder angle [rad], (2,)."""
        return self.vessel.command_limit

    def tau(self, command: Floats) -> Floats:
        """Return surge force, sway force and yaw moment (..., 3) [N, N, N m] of a command (eq. 2.23).

        Args:
            command: (..., 2) propeller force [N] and rudder angle [rad].
        """
        force, rudder = command[..., 0], command[..., 1]
        sideways = force * np.sin(rudder)
        surge = force * np.cos(rudder)
        return np.stack([surge, -sideways, self.vessel.propeller_arm_m * sideways], axis=-1)

    def nu_dot(self, nu: Floats, tau: Floats, coefficients: Floats | None = None) -> Floats:
        """Return nu' (n, 3) in the body frame, from M nu' = tau - C(nu) nu - D(nu) nu (eq. 2.5).

        Args:
            coefficients: as in `step_and_travel`.
        """
        own = Coefficients(*(self.coefficients if coefficients is None else coefficients).T)
        inverse_inertia = np.zeros((len(own.i00), 3, 3))
        for row, column in NONZERO:
            inverse_inertia[:, row, column] = getattr(own, f"i{row}{column}")
        resistance = (coriolis(own, nu) + damping(own, nu)) @ nu[:, :, None]
        return np.asarray(inverse_inertia @ (tau[:, :, None] - resistance))[:, :, 0]

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
        """Return pose and velocity (n, 3) one control period later, and the travel of the hull (n,) [m].

        Args:
            eta, nu: as in `step`.
            tau: (n, k, 3) surge force, sway force and yaw moment [N, N, N m], in equal parts of the period;
                k divides the number of substeps.
            coefficients: (n, 17) of each boat, as `coefficients` returns them; by default of the vessel.

        Returns:
            The third result is an upper bound on the distance that any point of the hull travels.
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
        from dockctl.sim.integration import integrate  # compiles on import: not for a dry run

        period, substeps = self.vessel.control_period_s, self.vessel.substeps
        own = self.coefficients if coefficients is None else coefficients
        after: tuple[Floats, Floats, Floats] = integrate(
            eta, nu, tau, own, period / substeps, substeps, self.vessel.hull.reach_m, states
        )
        return after


class ReferenceVesselModel(VesselModel):
    """The reference implementation: classical Runge-Kutta with the matrices above, not compiled."""

    def _integrate(
        self, eta: Floats, nu: Floats, tau: Floats, coefficients: Floats | None, states: Floats
    ) -> tuple[Floats, Floats, Floats]:
        substeps, reach = self.vessel.substeps, self.vessel.hull.reach_m
        h = self.vessel.control_period_s / substeps

        def rate(state: Floats, tau: Floats) -> Floats:
            eta, nu = state[:, :3], state[:, 3:]
            return np.hstack([self.eta_dot(eta, nu), self.nu_dot(nu, tau, coefficients)])

        state, travel = np.hstack([eta, nu]), np.zeros(len(eta))
        for number in range(substeps):
            if len(states):
                states[:, number] = state
            force = tau[:, number * tau.shape[1] // substeps]
            with np.errstate(over="ignore", invalid="ignore"):  # the simulator reports what diverges
                k1 = rate(state, force)
                k2 = rate(state + h / 2 * k1, force)
                k3 = rate(state + h / 2 * k2, force)
                k4 = rate(state + h * k3, force)
            change = h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
            travel += np.hypot(change[:, 0], change[:, 1]) + reach * np.abs(change[:, 2])
            state = state + change
        if len(states):
            states[:, substeps] = state
        return state[:, :3], state[:, 3:], travel


def coefficients(vessel: Vessel) -> Floats:
    """Return the coefficients (17,) of the equations of motion in the order of `Coefficients`."""
    inverse = np.linalg.inv(vessel.inertia)
    named = (getattr(vessel, name) for name in Coefficients._fields[len(NONZERO) :])
    return np.array([*(inverse[index] for index in NONZERO), *named])
