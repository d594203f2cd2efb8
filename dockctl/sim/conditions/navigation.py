"""Errors of the measured pose and velocity, as from a satellite receiver with inertial sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import NonNegative, Speed
from dockctl.scenarios.extensions import OFF, Condition, Disturbance, Drawn, draw, register
from dockctl.sim.conditions.draws import draw_seed, normals

HalfTurn = Annotated[NonNegative, Field(le=180)]


@register(CONDITIONS, group="sensing", source="not in the thesis")
class Navigation(Condition):
    """Standard deviations of x and y, heading, surge and sway, and yaw rate; each step draws its own."""

    examples = ({"position_m": 0.02, "heading_deg": [0, 0.5], "velocity_mps": 0.03},)
    kind: Literal["navigation"] = "navigation"
    position_m: Drawn[Annotated[NonNegative, Field(le=100)]] = OFF
    heading_deg: Drawn[HalfTurn] = OFF
    velocity_mps: Drawn[Speed] = OFF
    yaw_rate_degps: Drawn[HalfTurn] = OFF

    def build(self, num_boats: int) -> Disturbance:
        return NavigationErrors(self, num_boats)


class NavigationErrors(Disturbance):
    """The errors of n boats."""

    def __init__(self, navigation: Navigation, num_boats: int) -> None:
        self.navigation = navigation
        self.sigma, self.error = np.zeros((num_boats, 6)), np.zeros((num_boats, 6))
        self.seed, self.drawn = np.zeros(num_boats, np.uint64), np.zeros(num_boats, np.int64)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        given = self.navigation
        for row, rng in zip(rows, rngs, strict=True):
            position, velocity = draw(given.position_m, rng), draw(given.velocity_mps, rng)
            heading = np.radians(draw(given.heading_deg, rng))
            yaw_rate = np.radians(draw(given.yaw_rate_degps, rng))
            self.sigma[row] = position, position, heading, velocity, velocity, yaw_rate
            self.seed[row] = draw_seed(rng)
        self.drawn[rows] = 6
        self.error[rows] = self.sigma[rows] * normals(self.seed[rows], 0 * rows, 6)

    def advance(self, period_s: float) -> None:
        self.error = self.sigma * normals(self.seed, self.drawn, 6)
        self.drawn += 6

    def pose_error(self) -> Floats:
        return self.error[:, :3]

    def velocity_error(self) -> Floats:
        return self.error[:, 3:]

    def episode(self) -> dict[str, Floats]:
        position, _, heading, velocity, _, yaw_rate = self.sigma.T
        return {
            "position_m": position,
            "heading_deg": np.degrees(heading),
            "velocity_mps": velocity,
            "yaw_rate_degps": np.degrees(yaw_rate),
        }
