"""Sectors of the range sensor that fail: blind, frozen, or covered by a close object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from dockctl.errors import DockctlError
from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import Count, NonNegative
from dockctl.scenarios.extensions import OFF, Condition, Disturbance, Drawn, draw, register


class SectorError(DockctlError):
    """A faulty sector does not exist in the range sensor."""

    code = "out_of_range"
    field = "conditions.lidar_faults.sectors"

    def __init__(self, sector: int, sectors: int) -> None:
        self.reason = f"found {sector}, but the range sensor has {sectors} sectors"
        super().__init__(f"{self.field}: {self.reason}")


@register(
    CONDITIONS, group="sensing", source="not in the thesis; its section 5.2 asks for the LiDAR's influence"
)
class LidarFaults(Condition):
    """Sectors, numbered from 1, that are faulty from the time `after_s` of the episode onward.

    A blind sector reads the maximum range of the sensor, as without a return; a frozen sector keeps its first
    value after the fault; an occluded sector reads `occluded_m`.
    """

    examples = ({"sectors": [1, 4], "mode": "frozen", "after_s": [0, 3]},)
    kind: Literal["lidar_faults"] = "lidar_faults"
    sectors: tuple[Count, ...] = Field(min_length=1, description="numbers of the faulty sectors, from 1")
    mode: Literal["blind", "frozen", "occluded"] = "blind"
    occluded_m: NonNegative = 0.5
    after_s: Drawn[NonNegative] = OFF

    def build(self, num_boats: int) -> Disturbance:
        return FaultySectors(self, num_boats)


class FaultySectors(Disturbance):
    """The faults of n boats' range sensors."""

    def __init__(self, faults: LidarFaults, num_boats: int) -> None:
        self.faults = faults
        self.after, self.elapsed = np.zeros((2, num_boats))
        self.frozen = np.zeros(num_boats, bool)
        self.values = np.zeros((num_boats, len(faults.sectors)))

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        self.after[rows] = [draw(self.faults.after_s, rng) for rng in rngs]
        self.elapsed[rows], self.frozen[rows] = 0.0, False

    def advance(self, period_s: float) -> None:
        self.elapsed += period_s

    def reported_ranges(self, ranges: Floats, rows: Ints, range_m: float) -> Floats:
        """Replace the ranges of the faulty sectors.

        Raises:
            SectorError: the sensor does not have these sectors.
        """
        sectors = np.array(self.faults.sectors) - 1
        if sectors.max() >= ranges.shape[1]:
            raise SectorError(int(sectors.max()) + 1, ranges.shape[1])
        failed = self.elapsed[rows] >= self.after[rows]
        if self.faults.mode == "frozen":
            fresh = failed & ~self.frozen[rows]
            self.values[rows[fresh]] = ranges[fresh][:, sectors]
            self.frozen[rows[fresh]] = True
        else:
            self.values[rows] = range_m if self.faults.mode == "blind" else self.faults.occluded_m
        reported = ranges.copy()
        reported[np.ix_(failed, sectors)] = self.values[rows[failed]]
        return reported

    def episode(self) -> dict[str, Floats]:
        return {"after_s": self.after}
