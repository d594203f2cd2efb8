"""Sectors of the range sensor that fail: blind, frozen, or covered by a close object."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.base import MAX_COORDINATE_M, Count, FieldError, NonNegative
from dockctl.scenarios.extensions import OFF, Condition, Disturbance, Drawn, draw, register

ROUNDING_S = 1e-9
"""More than the rounding error of a sum of control periods."""


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
    occluded_m: Annotated[NonNegative, Field(le=MAX_COORDINATE_M)] = 0.5
    after_s: Drawn[NonNegative] = OFF

    @model_validator(mode="after")
    def _sectors_differ(self) -> Self:
        for index, sector in enumerate(self.sectors):
            if sector in self.sectors[:index]:
                raise FieldError(f"sectors.{index}", f"{sector} is listed twice", "duplicate")
        return self

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
            FieldError: the sensor does not have these sectors, or never reads such a range.
        """
        sectors = np.array(self.faults.sectors) - 1
        if (last := sectors.max() + 1) > ranges.shape[1]:
            message = f"found {last}, but the range sensor has {ranges.shape[1]} sectors"
            raise FieldError("sectors", message, "out_of_range")
        if self.faults.mode == "occluded" and self.faults.occluded_m > range_m:
            message = f"found {self.faults.occluded_m:g}, but the range sensor reads at most {range_m:g} m"
            raise FieldError("occluded_m", message, "out_of_range")
        failed = self.elapsed[rows] >= self.after[rows] - ROUNDING_S
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
