"""A 3-DOF vessel as data (thesis eqs. 2.17-2.23, Table 3.1)."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from dockctl.scenarios.base import Count, Model, NonNegative, Number, Positive


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
        if surge <= 0 or sway * yaw - self.Y_rdot_kgm**2 <= 0:
            raise ValueError("the inertia matrix (eq. 2.17) is not positive definite; added mass is negative")
        return self
