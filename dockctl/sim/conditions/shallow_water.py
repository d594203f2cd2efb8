"""Shallow water: added mass and damping in sway and yaw as functions of depth and draft.

The factors are regressions for ships. A small boat is outside their data: they give the sign and the order of
magnitude of the effect, not a measured value. Surge, squat, banks and quays are not modeled.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import FieldError, Fraction, Length
from dockctl.scenarios.extensions import Condition, Disturbance, Drawn, draw, register
from dockctl.scenarios.vessel import Vessel

WATER_KGPM3 = 1000.0
LEAST_DEPTH = 1.2
"""Minimum depth, in drafts, at which the regressions are valid."""


@register(CONDITIONS, group="water", source="not in the thesis; Taimuri et al. 2020")
class ShallowWater(Condition):
    """Depth of the water; the vessel's own coefficients are those of deep water.

    By default the dimensions are those of the hull, and the block coefficient follows from the vessel's mass.
    """

    examples = ({"depth_m": [0.4, 2]},)
    is_single = True
    kind: Literal["shallow_water"] = "shallow_water"
    depth_m: Drawn[Length]
    length_m: Length | None = None
    beam_m: Length | None = None
    draft_m: Length | None = None
    block_coefficient: Fraction | None = None

    def fitted(self, vessel: Vessel) -> Condition:
        hull = vessel.hull
        own: dict[str, float] = {
            "length_m": hull.length_m,
            "beam_m": hull.beam_m,
            "draft_m": hull.draft_m,
        }
        own = {key: value if getattr(self, key) is None else getattr(self, key) for key, value in own.items()}
        box = WATER_KGPM3 * own["length_m"] * own["beam_m"] * own["draft_m"]
        block = min(1.0, vessel.mass_kg / box) if self.block_coefficient is None else self.block_coefficient
        least = LEAST_DEPTH * own["draft_m"]
        if self.depth_m[0] < least:
            message = f"found {self.depth_m[0]:g} m, expected at least {LEAST_DEPTH:g} drafts, {least:g} m"
            raise FieldError("depth_m", message, "out_of_range", f"{least:g}")
        fitted = self.model_copy(update={**own, "block_coefficient": block})
        for factors in fitted.extreme_factors():
            vessel.require_scalable(factors, "depth_m")
        return fitted

    def extreme_factors(self) -> list[dict[str, float]]:
        factors = depth_factors(self, np.array(self.depth_m))
        return [{name: float(each[i]) for name, each in factors.items()} for i in range(len(self.depth_m))]

    def build(self, num_boats: int) -> Disturbance:
        return Depth(self, num_boats)


class Depth(Disturbance):
    """The depth of the water of n boats."""

    def __init__(self, water: ShallowWater, num_boats: int) -> None:
        self.water, self.depth = water, np.full(num_boats, water.depth_m[-1])

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        self.depth[rows] = [draw(self.water.depth_m, rng) for rng in rngs]

    def coefficient_factors(self) -> dict[str, Floats]:
        return depth_factors(self.water, self.depth)

    def episode(self) -> dict[str, Floats]:
        return {"depth_m": self.depth}


def depth_factors(water: ShallowWater, depth_m: Floats) -> dict[str, Floats]:
    """Return the factors (n,) of the coefficients of sway and yaw at depths (n,) [m]; 1 in deep water.

    Added mass: K0 + 2/3 K1 b + 8/15 K2 b^2 in sway and K0 + 8/15 K1 b + 40/105 K2 b^2 in yaw. Damping, linear
    and quadratic: 3/2 (K0 + 1/2 K1 b + 1/3 K2 b^2) - 1/2 in sway, and the added-mass factor in yaw. K0, K1
    and K2 are functions of h/T - 1; b = C_b B/T (1 + B/L)^2. From Taimuri et al. (2020, Ocean Engineering
    218, 108103), as implemented in the open-source package mmgdynamics, which however multiplies K2 of wide
    hulls by B/T: it is continuous at B/T = 4 only with T/B, as here.
    """
    length, beam, draft, block = water.length_m, water.beam_m, water.draft_m, water.block_coefficient
    assert length is not None and beam is not None and draft is not None and block is not None  # by `fitted`
    gap = depth_m / draft - 1
    k0 = 1 + 0.0775 / gap**2 - 0.011 / gap**3 + 0.000068 / gap**5
    k1 = -0.0643 / gap + 0.0724 / gap**2 - 0.0113 / gap**3 + 0.0000767 / gap**5
    k2 = (0.0342 if beam / draft <= 4 else 0.137 * draft / beam) / gap
    b = block * beam / draft * (1 + beam / length) ** 2
    sway_mass = k0 + 2 / 3 * k1 * b + 8 / 15 * k2 * b**2
    yaw_mass = k0 + 8 / 15 * k1 * b + 40 / 105 * k2 * b**2
    sway = 1.5 * (k0 + k1 * b / 2 + k2 * b**2 / 3) - 0.5
    return {
        "Y_vdot_kg": sway_mass,
        "N_rdot_kgm2": yaw_mass,
        "Y_v_kgps": sway,
        "Y_vv_kgpm": sway,
        "N_r_kgm2ps": yaw_mass,
        "N_rr_kgm2": yaw_mass,
    }
