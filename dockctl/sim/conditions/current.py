"""A current that is the same everywhere and does not change during an episode."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import NonNegative, Number
from dockctl.scenarios.extensions import Condition, Disturbance, Drawn, draw, register


@register(CONDITIONS, group="water", source="not in the thesis; Fossen 2012")
class Current(Condition):
    """Speed of the water, and the direction in which it flows, counterclockwise from +x."""

    kind: Literal["current"] = "current"
    speed_mps: Drawn[NonNegative]
    direction_deg: Drawn[Number]

    def build(self, num_boats: int) -> Disturbance:
        return UniformFlow(self, num_boats)


class UniformFlow(Disturbance):
    """The current of n boats."""

    def __init__(self, current: Current, num_boats: int) -> None:
        self.current = current
        self.velocity = np.zeros((num_boats, 2))

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        for row, rng in zip(rows, rngs, strict=True):
            speed = draw(self.current.speed_mps, rng)
            direction = np.radians(draw(self.current.direction_deg, rng))
            self.velocity[row] = speed * np.cos(direction), speed * np.sin(direction)

    def water_velocity(self) -> Floats:
        return self.velocity
