"""A 3-DOF vessel as data (thesis eqs. 2.17-2.23, Table 3.1)."""

from __future__ import annotations

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from dockctl.scenarios.base import Count, FieldError, Model, NonNegative, Number, Positive

RK4_STABILITY_LIMIT = 2.6
"""Classical Runge-Kutta is stable if decay rate times step is below this limit: its stability region, which
ends at 2.79 on the real axis, includes the half disk of this radius."""


class Hull(Model):
    """Box-like hull with a pointed bow [m], used for collisions and drawings."""

    length_m: Positive = 3.0
    beam_m: Positive = 1.0
    draft_m: Positive = 0.3
    freeboard_m: Positive = 0.5


class Vessel(Model):
    """Coefficients of ``M nu_dot + C(nu) nu + D(nu) nu = tau`` (thesis Table 3.1) and actuator limits.

    Names follow Fossen. As in Table 3.1, damping coefficients are positive and added masses negative.
    """

    name: str = "vessel"
    hull: Hull = Hull()
    mass_kg: Positive
    yaw_inertia_kgm2: Positive
    X_udot_kg: Number = 0.0
    Y_vdot_kg: Number = 0.0
    Y_rdot_kgm: Number = 0.0
    N_rdot_kgm2: Number = 0.0
    X_u_kgps: NonNegative
    X_uu_kgpm: NonNegative
    Y_v_kgps: NonNegative
    Y_vv_kgpm: NonNegative
    Y_r_kgmps: Number = 0.0
    N_v_kgmps: Number = 0.0
    N_r_kgm2ps: NonNegative
    N_rr_kgm2: NonNegative
    propeller_arm_m: Positive = Field(description="distance a of the propeller aft of the center of gravity")
    max_propeller_n: Positive = 50.0
    max_rudder_deg: Positive = Field(default=30.0, le=90.0)
    control_period_s: Positive = 0.5
    substeps: Count = Field(default=5, le=10_000, description="RK4 steps per control period")

    @property
    def inertia(self) -> NDArray[np.float64]:
        """M (3, 3), rigid body and added mass (eq. 2.17) [kg, kg m, kg m^2]."""
        return np.array(
            [
                [self.mass_kg - self.X_udot_kg, 0.0, 0.0],
                [0.0, self.mass_kg - self.Y_vdot_kg, -self.Y_rdot_kgm],
                [0.0, -self.Y_rdot_kgm, self.yaw_inertia_kgm2 - self.N_rdot_kgm2],
            ]
        )

    @model_validator(mode="after")
    def _inertia_is_positive_definite(self) -> Self:
        (surge, _, _), (_, sway, coupling), (_, _, yaw) = self.inertia.tolist()
        if surge <= 0 or sway * yaw - coupling * coupling <= 0:
            raise ValueError(
                "the inertia matrix (eq. 2.17) is not positive definite; expected negative added masses"
            )
        return self

    @model_validator(mode="after")
    def _substeps_are_stable(self) -> Self:
        rate = self._fastest_rate()
        needed = rate * self.control_period_s / RK4_STABILITY_LIMIT
        if not needed < self.substeps:
            raise FieldError(
                "substeps",
                f"{self.substeps} in {self.control_period_s:g} s are unstable, since the vessel's fastest"
                f" motion decays at {rate:.3g} 1/s; expected at least {needed // 1 + 1:.0f}",
                "out_of_range",
            )
        return self

    def _fastest_rate(self) -> float:
        """Return the fastest decay rate [1/s] of surge and of coupled sway and yaw: eigenvalues of M^-1 D.

        D is linearized, d/du (D_1 + D_2 |u|) u = D_1 + 2 D_2 |u|, at the speed at which damping balances the
        full propeller force in that direction; Coriolis forces are neglected.
        """
        force, moment = self.max_propeller_n, self.max_propeller_n * self.propeller_arm_m
        surge = _linearized_damping(self.X_u_kgps, self.X_uu_kgpm, force)
        sway = _linearized_damping(self.Y_v_kgps, self.Y_vv_kgpm, force)
        yaw = _linearized_damping(self.N_r_kgm2ps, self.N_rr_kgm2, moment)
        damping = np.array([[surge, 0.0, 0.0], [0.0, sway, self.Y_r_kgmps], [0.0, self.N_v_kgmps, yaw]])
        return float(max(abs(np.linalg.eigvals(np.linalg.solve(self.inertia, damping)))))


def _linearized_damping(linear: float, quadratic: float, force: float) -> float:
    """Return d1 + 2 d2 s at the speed s where (d1 + d2 s) s equals `force`."""
    return math.sqrt(linear * linear + 4 * quadratic * force)
