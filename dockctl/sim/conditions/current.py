"""A spatially uniform current: constant during an episode, or first-order Gauss-Markov."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import NonNegative, Positive, Speed
from dockctl.scenarios.extensions import OFF, Condition, Directions, Disturbance, Drawn, draw, register
from dockctl.scenarios.vessel import Vessel
from dockctl.sim.conditions.authority import ControlAuthority
from dockctl.sim.conditions.draws import draw_seed, gauss_markov, normals


@register(CONDITIONS, group="water", source="not in the thesis; Fossen 2012, 2021 section 10.3")
class Current(Condition):
    """Mean speed of the water, the direction in which it flows, counterclockwise from +x, and its variation.

    The variation, a standard deviation, is added to both components in the world frame.
    """

    examples = (
        {"speed_mps": [0.0, 0.2], "direction_deg": [0, 360]},
        {"speed_mps": [0.0, 0.2], "direction_deg": [0, 360], "variation_mps": 0.02},
    )
    kind: Literal["current"] = "current"
    speed_mps: Drawn[Speed]
    direction_deg: Directions
    variation_mps: Drawn[Annotated[NonNegative, Field(le=3)]] = OFF
    variation_time_s: Positive = 100.0

    def build(self, num_boats: int) -> Disturbance:
        return UniformFlow(self, num_boats)

    @property
    def _strongest_mps(self) -> float:
        return self.speed_mps[-1] + 2 * self.variation_mps[-1]

    def side_force_n(self, vessel: Vessel) -> float:
        return ControlAuthority.of(vessel).side_drag(self._strongest_mps)

    def notes(self, vessel: Vessel) -> list[tuple[str, str]]:
        authority, speed, push = ControlAuthority.of(vessel), self._strongest_mps, self.side_force_n(vessel)
        if push <= authority.side_force_n:
            return []
        variation = " (mean and two standard deviations)" if self.variation_mps != OFF else ""
        return [
            (
                "speed_mps",
                f"holding the boat across a current of {speed:g} m/s{variation} takes {push:.1f} N sideways;"
                f" the vessel has {authority.side_force_n:.1f} N, and {authority.crab(speed)}",
            )
        ]


class UniformFlow(Disturbance):
    """The current of n boats."""

    def __init__(self, current: Current, num_boats: int) -> None:
        self.current = current
        self.speed, self.sigma = np.zeros((2, num_boats))
        self.direction, self.variation = np.zeros((2, num_boats, 2))
        self.seed, self.drawn = np.zeros(num_boats, np.uint64), np.zeros(num_boats, np.int64)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        for row, rng in zip(rows, rngs, strict=True):
            self.speed[row] = draw(self.current.speed_mps, rng)
            direction = np.radians(draw(self.current.direction_deg, rng))
            self.direction[row] = np.cos(direction), np.sin(direction)
            if self._varies:
                self.sigma[row] = draw(self.current.variation_mps, rng)
                self.seed[row] = draw_seed(rng)
        if self._varies:
            self.drawn[rows] = 2
            self.variation[rows] = self.sigma[rows, None] * normals(self.seed[rows], 0 * rows, 2)

    def advance(self, period_s: float) -> None:
        if self._varies:
            noise = self.sigma[:, None] * normals(self.seed, self.drawn, 2)
            self.variation = gauss_markov(self.variation, noise, period_s, self.current.variation_time_s)
            self.drawn += 2

    def water_velocity(self) -> Floats:
        return self.speed[:, None] * self.direction + self.variation

    def episode(self) -> dict[str, Floats]:
        x, y = self.direction.T
        drawn = {"speed_mps": self.speed, "direction_deg": np.degrees(np.arctan2(y, x))}
        return {**drawn, "variation_mps": self.sigma} if self._varies else drawn

    @property
    def _varies(self) -> bool:
        return self.current.variation_mps != OFF
