"""A 3-DOF vessel as data (thesis eqs. 2.17-2.23, Table 3.1)."""

from __future__ import annotations

import cmath
import math
from typing import Self

from pydantic import Field, model_validator

from dockctl.scenarios.base import Count, FieldError, Model, NonNegative, Number, Positive

RK4_REACH = 2.6
"""Classical Runge-Kutta damps every decaying motion whose rate times the step is less; the half disk of that
radius lies in its region of stability, which ends at 2.79 on the real axis."""


class Hull(Model):
    """Box-like hull with a pointed bow, for the collision body and for drawings; metres."""

    length_m: Positive = 3.0
    beam_m: Positive = 1.0
    draft_m: Positive = 0.3
    freeboard_m: Positive = 0.5


class Vessel(Model):
    """Coefficients of ``M nu' + C(nu) nu + D(nu) nu = tau`` (thesis Table 3.1) and the actuator's limits.

    The names are Fossen's. Damping coefficients are positive numbers that brake, as in Table 3.1;
    added masses are negative, as in Table 3.1.
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
    propeller_arm_m: Positive = Field(description="from the centre of gravity aft to the propeller, a")
    max_propeller_n: Positive = 50.0
    max_rudder_deg: Positive = Field(default=30.0, le=90.0)
    control_period_s: Positive = 0.5
    substeps: Count = Field(default=5, le=10_000, description="RK4 steps a control period")

    @model_validator(mode="after")
    def _inertia_is_positive_definite(self) -> Self:
        surge = self.mass_kg - self.X_udot_kg
        sway = self.mass_kg - self.Y_vdot_kg
        yaw = self.yaw_inertia_kgm2 - self.N_rdot_kgm2
        if surge <= 0 or sway * yaw - self.Y_rdot_kgm * self.Y_rdot_kgm <= 0:
            raise ValueError("the inertia matrix (eq. 2.17) is not positive definite; added mass is negative")
        return self

    @model_validator(mode="after")
    def _substeps_are_stable(self) -> Self:
        rate = self._fastest_rate()
        needed = rate * self.control_period_s / RK4_REACH
        if not needed < self.substeps:
            raise FieldError(
                "substeps",
                f"{self.substeps} in {self.control_period_s:g} s are unstable, since the vessel's fastest"
                f" motion decays at {rate:.3g} 1/s; expected at least {needed // 1 + 1:.0f}",
                "out_of_range",
            )
        return self

    def _fastest_rate(self) -> float:
        """Return the fastest decay [1/s] of surge, and of sway and yaw together: eigenvalues of M^-1 D.

        The damping is that of small changes, d/du (D_1 + D_2 |u|) u = D_1 + 2 D_2 |u|, at the speed at which
        it takes up the whole force of the propeller in this direction alone; Coriolis forces are left out.
        """
        force, moment = self.max_propeller_n, self.max_propeller_n * self.propeller_arm_m
        surge = _slope(self.X_u_kgps, self.X_uu_kgpm, force)
        sway = _slope(self.Y_v_kgps, self.Y_vv_kgpm, force)
        yaw = _slope(self.N_r_kgm2ps, self.N_rr_kgm2, moment)
        m, both, inertia = (
            self.mass_kg - self.Y_vdot_kg,
            -self.Y_rdot_kgm,
            self.yaw_inertia_kgm2 - self.N_rdot_kgm2,
        )
        determinant = m * inertia - both * both
        half = (inertia * sway - both * (self.N_v_kgmps + self.Y_r_kgmps) + m * yaw) / determinant / 2
        product = (sway * yaw - self.Y_r_kgmps * self.N_v_kgmps) / determinant
        root = cmath.sqrt(half * half - product)
        return max(surge / (self.mass_kg - self.X_udot_kg), abs(half + root), abs(half - root))


def _slope(linear: float, quadratic: float, force: float) -> float:
    """Return d1 + 2 d2 s at the speed s at which (d1 + d2 s) s is `force`."""
    return math.sqrt(linear * linear + 4 * quadratic * force)
