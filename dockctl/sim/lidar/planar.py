"""A planar scanner: one horizontal circle of rays around the body's origin."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from dockctl.geometry import Floats, Ints
from dockctl.plugins import RANGE_SENSORS
from dockctl.scenarios.base import Count, NonNegative
from dockctl.scenarios.extensions import RangeNoise, RangeSensor, RangeSensorSpec, register
from dockctl.sim.lidar.spinning import MAX_ARM_M

if TYPE_CHECKING:
    from dockctl.sim.lidar.raycast import BoundingVolumes

BYTES_PER_TRIANGLE = 200  # of the tree over the harbor


@register(RANGE_SENSORS, source="not in the thesis")
class PlanarScanner(RangeSensorSpec):
    """One horizontal circle of rays at height `z_m`; ray 0 points ahead, then counterclockwise."""

    examples = ({"rays": 90},)
    kind: Literal["planar"] = "planar"
    z_m: Annotated[NonNegative, Field(le=MAX_ARM_M)] = 1.0
    rays: Count = Field(default=720, le=50_000)

    @property
    def is_symmetric(self) -> bool:
        return True

    @property
    def origins(self) -> tuple[tuple[float, float, float], ...]:
        return ((0.0, 0.0, self.z_m),)

    def build(self, triangles: Floats) -> RangeSensor:
        return PlanarSensor(self, triangles)


@dataclass(frozen=True, eq=False)
class PlanarSensor:
    """A planar scanner in one harbor.

    Args:
        spec: the scanner.
        triangles: (m, 3, 3) surface of the harbor in the world frame [m].
    """

    spec: PlanarScanner
    triangles: Floats

    @property
    def table_bytes(self) -> int:
        return BYTES_PER_TRIANGLE * len(self.triangles)

    @cached_property
    def _volumes(self) -> BoundingVolumes:
        from dockctl.sim.lidar.raycast import BoundingVolumes

        return BoundingVolumes.build(self.triangles)

    @cached_property
    def _rays(self) -> tuple[Floats, Floats, Floats]:
        """Origins and directions (rays, 3) in the body frame, and lengths (rays,) [m]."""
        angle = np.arange(self.spec.rays) * (2 * np.pi / self.spec.rays)
        zero = np.zeros_like(angle)
        origins = np.column_stack([zero, zero, zero + self.spec.z_m])
        directions = np.column_stack([np.cos(angle), np.sin(angle), zero])
        return origins, directions, zero + self.spec.range_m

    @cached_property
    def _sectors(self) -> tuple[Ints, Ints]:
        """Rays and their sectors, (k,) each: all points of a ray from the body's origin are in one sector.

        A ray on the edge of two sectors is in both, so that port and starboard are mirror images.
        """
        rays, sectors = self.spec.rays, self.spec.sectors
        number = np.arange(rays)
        # The angle from dead astern, in units of 1 / (2 rays) of a sector: integers have no rounding errors.
        sector, remainder = np.divmod((2 * number + rays) * sectors % (2 * rays * sectors), 2 * rays)
        on_edge = remainder == 0
        others = (sector[on_edge] - 1) % sectors
        return np.concatenate([number, number[on_edge]]), np.concatenate([sector, others])

    def sector_ranges(self, eta: Floats) -> Floats:
        """Return the range of each sector's nearest return, (n, sectors) [m], from poses (n, 3)."""
        rays, sectors = self._sectors
        nearest = np.full((len(eta), self.spec.sectors), self.spec.range_m)
        for row, pose in zip(nearest, eta, strict=True):
            np.minimum.at(row, sectors, self._volumes.trace(pose, *self._rays)[rays])
        return nearest

    def noisy_sector_ranges(self, eta: Floats, noise: RangeNoise) -> Floats:
        """Return the range of each sector's nearest noisy return, (n, sectors) [m], from poses (n, 3)."""
        from dockctl.sim.lidar.return_noise import noisy_hits

        rays, sectors = self._sectors
        nearest = np.full((len(eta), self.spec.sectors), self.spec.range_m)
        given = zip(noise.seeds, noise.sigma_m, noise.lost_returns, strict=True)
        for row, pose, (seed, sigma_m, lost) in zip(nearest, eta, given, strict=True):
            hits = noisy_hits(self._volumes.trace(pose, *self._rays), seed, sigma_m, lost)
            np.minimum.at(row, sectors, hits[rays])
        return nearest

    def points(self, pose: Floats, every: int = 1) -> Floats:
        """Return the returns (k, 3) [m] of every n-th ray in the body frame from one pose (3,)."""
        origins, directions, reach = (array[::every] for array in self._rays)
        hits = self._volumes.trace(pose, origins, directions, reach)
        seen = np.isfinite(hits)
        return origins[seen] + hits[seen, None] * directions[seen]
