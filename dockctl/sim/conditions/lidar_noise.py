"""Noise of the range sensor: errors of the returns, lost returns, and lost sectors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import Fraction, NonNegative
from dockctl.scenarios.extensions import OFF, Condition, Disturbance, Drawn, RangeNoise, draw, register
from dockctl.sim.conditions.draws import derived_seeds, draw_seed


@register(CONDITIONS, group="sensing", source="not in the thesis; VLP-16 data sheet: 3 cm")
class LidarNoise(Condition):
    """Standard deviation of each return, share of returns that are lost, and share of sectors that are lost.

    Each scan draws its own. A lost sector reads the sensor's maximum range, as without a return.
    """

    examples = ({"sigma_m": [0, 0.03], "lost_returns": 0.05, "lost_sectors": 0.2},)
    kind: Literal["lidar_noise"] = "lidar_noise"
    sigma_m: Drawn[Annotated[NonNegative, Field(le=10)]] = OFF
    lost_returns: Drawn[Fraction] = OFF
    lost_sectors: Drawn[Fraction] = OFF

    def build(self, num_boats: int) -> Disturbance:
        return LidarErrors(self, num_boats)


class LidarErrors(Disturbance):
    """The noise of n boats' range sensors."""

    def __init__(self, noise: LidarNoise, num_boats: int) -> None:
        self.noise = noise
        self.sigma, self.lost_returns, self.lost_sectors = np.zeros((3, num_boats))
        self.seed, self.scans = np.zeros(num_boats, np.uint64), np.zeros(num_boats, np.int64)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        for row, rng in zip(rows, rngs, strict=True):
            self.sigma[row] = draw(self.noise.sigma_m, rng)
            self.lost_returns[row] = draw(self.noise.lost_returns, rng)
            self.lost_sectors[row] = draw(self.noise.lost_sectors, rng)
            self.seed[row] = draw_seed(rng)
        self.scans[rows] = 0

    def advance(self, period_s: float) -> None:
        self.scans += 1

    def range_noise(self) -> RangeNoise:
        seeds = derived_seeds(self.seed, self.scans)
        return RangeNoise(seeds, self.sigma, self.lost_returns, self.lost_sectors)

    def episode(self) -> dict[str, Floats]:
        return {
            "sigma_m": self.sigma,
            "lost_returns": self.lost_returns,
            "lost_sectors": self.lost_sectors,
        }
