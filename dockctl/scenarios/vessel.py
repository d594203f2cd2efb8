"""Model of a 3-DOF vessel (thesis eqs. 2.17-2.23, Table 3.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import product
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from dockctl.scenarios.base import Count, FieldError, Model, NonNegative, Number, Positive, Title

SCALABLE = (
    "mass_kg",
    "yaw_inertia_kgm2",
    "X_udot_kg",
    "Y_vdot_kg",
    "Y_rdot_kgm",
    "N_rdot_kgm2",
    "X_u_kgps",
    "X_uu_kgpm",
    "Y_v_kgps",
    "Y_vv_kgpm",
    "Y_r_kgmps",
    "N_v_kgmps",
    "N_r_kgm2ps",
    "N_rr_kgm2",
)
"""The coefficients of the equations of motion, which conditions may scale."""
RK4_STABILITY_LIMIT = 2.6
"""Classical Runge-Kutta is stable if the fastest rate times the step is below this limit: the stability
region, which ends at 2.79 on the real axis, includes the half disk of this radius."""

MAX_SPEED_MPS = 100.0
"""Maximum allowed speed that the propeller can sustain; it is unbounded without damping."""


Size = Annotated[Number, Field(ge=0.01, le=1000)]


class Hull(Model):
    """Box-like hull with a pointed bow [m], used for collisions and drawings."""

    length_m: Size = 3.0
    beam_m: Size = 1.0
    draft_m: Size = 0.3
    freeboard_m: Size = 0.5

    @property
    def reach_m(self) -> float:
        """Horizontal distance from the body origin to the corners of the stern, the farthest points [m]."""
        return math.hypot(self.length_m / 2, self.beam_m / 2)


class Vessel(Model):
    """Coefficients of ``M nu_dot + C(nu) nu + D(nu) nu = tau`` (thesis Table 3.1) and actuator limits.

    Names follow Fossen. As in Table 3.1, damping coefficients are positive and added masses negative.
    """

    name: Title = "vessel"
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

    @property
    def command_limit(self) -> NDArray[np.float64]:
        """Maximum propeller force [N] and rudder angle [rad], (2,)."""
        return np.array([self.max_propeller_n, np.radians(self.max_rudder_deg)])

    @property
    def max_side_n(self) -> float:
        """Maximum sway force of the propeller (eq. 2.23) [N]."""
        return self.max_propeller_n * math.sin(math.radians(self.max_rudder_deg))

    def require_scalable(self, factors: Mapping[str, float], field: str) -> None:
        """Check that the vessel remains valid if its coefficients are multiplied by factors.

        Args:
            factors: factors by the name of the coefficient.
            field: the field that causes them, for the error.

        Raises:
            FieldError: it does not.
        """
        scaled = {name: getattr(self, name) * factor for name, factor in factors.items()}
        try:
            Vessel.model_validate({**dict(self), **scaled})
        except ValidationError as error:
            first = error.errors()[0]
            reason = first["msg"].removeprefix("Value error, ")
            if first["type"] != "value_error":  # of a single coefficient
                reason = f"{first['loc'][0]} would be {first['input']:g}"
            raise FieldError(field, f"changes the vessel too much: {reason}", "out_of_range") from None

    @model_validator(mode="after")
    def _inertia_is_positive_definite(self) -> Self:
        (surge, _, _), (_, sway, coupling), (_, _, yaw) = self.inertia.tolist()
        if not (0 < surge < math.inf and 0 < sway * yaw - coupling * coupling < math.inf):
            raise ValueError(
                "the inertia matrix (eq. 2.17) is not positive definite; expected negative added masses"
            )
        return self

    @model_validator(mode="after")
    def _damping_dissipates_energy(self) -> Self:
        coupling = self.Y_r_kgmps + self.N_v_kgmps
        if not coupling * coupling <= 4 * self.Y_v_kgps * self.N_r_kgm2ps:
            raise FieldError(
                "Y_r_kgmps" if abs(self.Y_r_kgmps) > abs(self.N_v_kgmps) else "N_v_kgmps",
                f"Y_r + N_v is {coupling:g}, so that the damping can add energy; expected at most"
                f" 2 sqrt(Y_v N_r), {2 * math.sqrt(self.Y_v_kgps * self.N_r_kgm2ps):g}, in magnitude",
                "out_of_range",
            )
        return self

    @model_validator(mode="after")
    def _motion_is_bounded_and_stable(self) -> Self:
        with np.errstate(all="ignore"):  # a value that overflows is rejected
            surge, sway_yaw, together = self._sustained_norms()
            bounds = together * np.sqrt(np.diag(np.linalg.inv(self.inertia)))
            if not max(bounds[:2]) < MAX_SPEED_MPS:
                raise FieldError(
                    "X_u_kgps" if surge > sway_yaw else "Y_v_kgps",
                    f"the propeller could sustain {max(bounds[:2]):.3g} m/s; expected less than"
                    f" {MAX_SPEED_MPS:g}: more damping (linear or quadratic in surge, and in sway and yaw)",
                    "out_of_range",
                )
            rate = self._fastest_rate(bounds)
        limit = rate * self.control_period_s / RK4_STABILITY_LIMIT
        if not limit < self.substeps:
            needed = f"{limit // 1 + 1:.0f}"
            raise FieldError(
                "substeps",
                f"{self.substeps} in {self.control_period_s:g} s are unstable, because the vessel's velocity"
                f" changes at up to {rate:.3g} 1/s; expected at least {needed}",
                "out_of_range",
                needed,
            )
        return self

    def _sustained_norms(self) -> tuple[float, float, float]:
        """Return the greatest sqrt(nu^T M nu) under thrust: in surge, in sway and yaw, and in all together.

        Above the last one the kinetic energy decreases under any command. Coriolis forces do no work, so the
        thrust p s balances the damping q s^2 + c s^3; p, q and c are bounds for each mix of surge and of sway
        with yaw, s = sqrt(nu^T M nu).
        """
        surge, block = self.inertia[0, 0], self.inertia[1:, 1:]
        scale = np.linalg.inv(np.linalg.cholesky(block))
        coupling = (self.Y_r_kgmps + self.N_v_kgmps) / 2
        linear = np.array([[self.Y_v_kgps, coupling], [coupling, self.N_r_kgm2ps]])
        slowest = max(np.linalg.eigvalsh(scale @ linear @ scale.T)[0], 0.0)
        own = np.diag(block) * (1 + abs(block[0, 1]) / math.sqrt(block[0, 0] * block[1, 1]))
        cubic = 1 / np.linalg.norm(own**1.5 / np.array([self.Y_vv_kgpm, self.N_rr_kgm2]))
        turning = self.max_side_n * np.linalg.norm(scale @ np.array([-1.0, self.propeller_arm_m]))
        angle = np.concatenate([[0.0], np.arctan(np.geomspace(1e-6, 1e6, 241)), [np.pi / 2]])
        x, y = np.abs([np.cos(angle), np.sin(angle)])
        p = self.max_propeller_n / np.sqrt(surge) * x + turning * y
        q = self.X_u_kgps / surge * x**2 + slowest * y**2
        c = self.X_uu_kgpm / surge**1.5 * x**3 + cubic * y**3
        norms = 2 * p / (q + np.sqrt(q**2 + 4 * c * p))
        return float(norms[0]), float(norms[-1]), float(norms.max())

    def _fastest_rate(self, bounds: NDArray[np.float64]) -> float:
        """Return the Lipschitz constant [1/s] of nu_dot in the energy norm, for speeds within (3,) bounds.

        Between zero and the bounds the Jacobian of (C + D) nu is linear in nu, so its norm is greatest at a
        corner.
        """
        scale = np.linalg.inv(np.linalg.cholesky(self.inertia))
        mass, X, Y, Y_r = self.mass_kg, self.X_udot_kg, self.Y_vdot_kg, self.Y_rdot_kgm
        rates = []
        for u, v, r in np.array(list(product((-1.0, 0.0, 1.0), repeat=3))) * bounds:
            coriolis = [
                [0.0, (Y - mass) * r, (Y - mass) * v + 2 * Y_r * r],
                [(mass - X) * r, 0.0, (mass - X) * u],
                [(X - Y) * v - Y_r * r, (X - Y) * u, -Y_r * u],
            ]
            damping = [
                [self.X_u_kgps + 2 * self.X_uu_kgpm * abs(u), 0.0, 0.0],
                [0.0, self.Y_v_kgps + 2 * self.Y_vv_kgpm * abs(v), self.Y_r_kgmps],
                [0.0, self.N_v_kgmps, self.N_r_kgm2ps + 2 * self.N_rr_kgm2 * abs(r)],
            ]
            jacobian = scale @ (np.array(coriolis) + damping) @ scale.T
            rates.append(np.linalg.norm(jacobian, 2) if np.isfinite(jacobian).all() else math.inf)
        return float(max(rates))
