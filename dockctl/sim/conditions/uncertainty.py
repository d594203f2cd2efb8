"""Vessel coefficients that differ from the scenario's, each by a factor drawn per episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import Fraction
from dockctl.scenarios.extensions import Condition, Disturbance, register
from dockctl.scenarios.vessel import Vessel

Share = Annotated[Fraction, Field(le=0.9)]
MASSES = ("mass_kg", "yaw_inertia_kgm2", "X_udot_kg", "Y_vdot_kg", "N_rdot_kgm2")
DAMPING = ("X_u_kgps", "X_uu_kgpm", "Y_v_kgps", "Y_vv_kgpm", "N_r_kgm2ps", "N_rr_kgm2")


@register(CONDITIONS, group="vessel", source="not in the thesis")
class Uncertainty(Condition):
    """Maximum deviation of each mass and damping coefficient, as a fraction: 0.2 is a factor of 0.8 to 1.2.

    The factors are drawn uniformly and independently. Coupling terms (Y_rdot, Y_r, N_v) do not change.
    """

    examples = ({"masses": 0.2, "damping": 0.1},)
    kind: Literal["uncertainty"] = "uncertainty"
    masses: Share = 0.0
    damping: Share = 0.0

    def fitted(self, vessel: Vessel) -> Condition:
        for factors in self.extreme_factors():
            vessel.require_scalable(factors, "damping" if self.damping >= self.masses else "masses")
        return self

    def extreme_factors(self) -> list[dict[str, float]]:
        return [
            {**dict.fromkeys(MASSES, mass), **dict.fromkeys(DAMPING, damping)}
            for mass in (1 - self.masses, 1 + self.masses)
            for damping in (1 - self.damping, 1 + self.damping)
        ]

    def build(self, num_boats: int) -> Disturbance:
        return Deviations(self, num_boats)


class Deviations(Disturbance):
    """The factors of n boats."""

    def __init__(self, uncertainty: Uncertainty, num_boats: int) -> None:
        self.uncertainty = uncertainty
        self.factors = np.ones((num_boats, len(MASSES) + len(DAMPING)))

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        given = self.uncertainty
        width = np.repeat([given.masses, given.damping], [len(MASSES), len(DAMPING)])
        for row, rng in zip(rows, rngs, strict=True):
            self.factors[row] = 1 + width * rng.uniform(-1, 1, len(width))

    def coefficient_factors(self) -> dict[str, Floats]:
        return dict(zip((*MASSES, *DAMPING), self.factors.T, strict=True))

    def episode(self) -> dict[str, Floats]:
        return {f"{name}_factor": factor for name, factor in self.coefficient_factors().items()}
