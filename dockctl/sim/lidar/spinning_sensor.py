"""The spinning LiDARs in one harbor: point clouds, and the range of the nearest return in each sector.

Thesis section 3.1.2, Tables 3.2 and 3.3, eqs. 3.1-3.8, Fig. 3.9.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dockctl import geometry
from dockctl.compute import Arrays, cached, on_all_cores, usable_cores
from dockctl.geometry import Floats, nearest_in_sectors
from dockctl.scenarios.extensions import RangeNoise
from dockctl.sim.lidar import height_grid, shell_table
from dockctl.sim.lidar.height_grid import FINEST_CELL_M, MAX_CELLS, HeightGrid
from dockctl.sim.lidar.raycast import BoundingVolumes
from dockctl.sim.lidar.return_noise import noisy_hits
from dockctl.sim.lidar.scan import sector_ranges, work_arrays
from dockctl.sim.lidar.shell_table import Levels, ShellTable, needed_radii
from dockctl.sim.lidar.spinning import LidarMount, SpinningLidars

if TYPE_CHECKING:
    from dockctl.sim.gpu.scan import GpuSensor

Ints = NDArray[np.int32]
Tables = tuple[ShellTable, HeightGrid, Levels]

# Measured on the reference marina with full LiDARs.
CELL_BYTES = 13  # of the grid of the harbor, per cell
GRID_MARGIN_M = 7.0  # of the grid around the harbor, both sides together


def rotation(mount: LidarMount) -> Floats:
    """Return the (3, 3) rotation from the LiDAR's frame to the body frame, Rz Ry Rx (eq. 3.2)."""
    roll, pitch, yaw = map(math.radians, (mount.roll_deg, mount.pitch_deg, mount.yaw_deg))
    ca, sa, cb, sb, cc, sc = *_cos_sin(roll), *_cos_sin(pitch), *_cos_sin(yaw)
    about_x = np.array([[1, 0, 0], [0, ca, -sa], [0, sa, ca]])
    about_y = np.array([[cb, 0, sb], [0, 1, 0], [-sb, 0, cb]])
    about_z = np.array([[cc, -sc, 0], [sc, cc, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x, np.float64)


def _cos_sin(angle: float) -> tuple[float, float]:
    return math.cos(angle), math.sin(angle)


@dataclass(frozen=True, eq=False)
class Rays:
    """All rays of one scan in the body frame, ordered by LiDAR, channel and firing.

    Attributes:
        origins, directions: (k, 3) [m] and unit vectors.
        reach: (k,) length of a ray [m]: to the sensor's maximum range, or to the water surface, which gives
            no return.
        channel: (k,) index of the laser over all LiDARs.
    """

    origins: Floats
    directions: Floats
    reach: Floats
    channel: Ints

    @classmethod
    def from_spec(cls, spec: SpinningLidars) -> Rays:
        """Return the rays of `spec`: mounts x channels x azimuth steps."""
        elevation = np.radians(np.linspace(spec.lowest_channel_deg, spec.highest_channel_deg, spec.channels))
        azimuth = np.arange(spec.azimuth_steps) * (2 * np.pi / spec.azimuth_steps)
        e, a = (grid.ravel() for grid in np.meshgrid(elevation, azimuth, indexing="ij"))
        beams = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
        origins = np.repeat(spec.origins, len(beams), axis=0)
        directions = np.concatenate([beams @ rotation(m).T for m in spec.mounts])
        falling = directions[:, 2] < 0
        to_water = np.divide(
            origins[:, 2], -directions[:, 2], out=np.full(len(falling), np.inf), where=falling
        )
        count = np.arange(len(directions), dtype=np.int32)
        return cls(
            origins=np.ascontiguousarray(origins, np.float64),
            directions=np.ascontiguousarray(directions),
            reach=np.minimum(spec.range_m, to_water),
            channel=count // spec.azimuth_steps,
        )


@dataclass(frozen=True, eq=False)
class SpinningSensor:
    """The LiDARs of the boat in one harbor.

    Args:
        spec: the sensors.
        triangles: (m, 3, 3) surface of the harbor in the world frame [m].
    """

    spec: SpinningLidars
    triangles: Floats

    @cached_property
    def rays(self) -> Rays:
        return Rays.from_spec(self.spec)

    @cached_property
    def _volumes(self) -> BoundingVolumes:
        return BoundingVolumes.build(self.triangles)

    @property
    def table_bytes(self) -> int:
        """Memory of the grid of the harbor [bytes], from its extent."""
        extent = np.ptp(self.triangles[:, :, :2], axis=(0, 1))
        cells = min(np.prod(extent + GRID_MARGIN_M) / FINEST_CELL_M**2, MAX_CELLS)
        return CELL_BYTES * int(cells)

    @property
    def _tables(self) -> Tables:
        """Tables of the compiled scan: rays by shells, the harbor grid, and its level for each cell.

        Not a `cached_property`: in Python 3.11 its lock would prevent building several tables in parallel.
        """
        built: Tables | None = vars(self).get("_built")
        if built is None:
            built = vars(self)["_built"] = self._build_tables()
        return built

    @cached_property
    def on_gpu(self) -> GpuSensor:
        """The same sensor on an NVIDIA GPU."""
        from dockctl.sim.gpu.scan import GpuSensor  # needs a GPU

        return GpuSensor(self._tables, self.spec.range_m, self.spec.sectors)

    def _build_tables(self) -> Tables:
        table = _shells(self.spec)
        radius = needed_radii(table).max()
        harbor = [self.triangles.tobytes(), radius.tobytes(), _source(height_grid)]
        grid = HeightGrid(**cached("harbor grid", harbor, lambda: self._build_grid(radius)))
        return table, grid, Levels.build(table, grid)

    def _build_grid(self, largest_radius_m: float) -> Arrays:
        return HeightGrid.build(self.triangles, largest_radius_m)._asdict()

    def sector_ranges(self, eta: Floats) -> Floats:
        """Return the range of the nearest return in each sector; exact, by branch and bound.

        Args:
            eta: (n, 3) x, y [m] and heading [rad].

        Returns:
            (n, sectors) horizontal distance from the body origin [m]; the sensor's maximum range if there is
            no return.
        """
        return self._scan(eta, None)

    def noisy_sector_ranges(self, eta: Floats, noise: RangeNoise) -> Floats:
        """Return the range of the nearest noisy return in each sector (n, sectors) [m]; exact.

        Args:
            eta: (n, 3) x, y [m] and heading [rad].
            noise: of the n scans.
        """
        return self._scan(eta, noise)

    def _scan(self, eta: Floats, noise: RangeNoise | None) -> Floats:
        poses = np.ascontiguousarray(eta, np.float64).reshape(-1, 3)
        out = np.empty((len(poses), self.spec.sectors))
        tables = self._tables

        def fill(rows: slice) -> None:
            own = (
                None if noise is None else (noise.seeds[rows], noise.sigma_m[rows], noise.lost_returns[rows])
            )
            work = work_arrays(tables[0])
            sector_ranges(*tables, self.spec.range_m, poses[rows], own, *work, out[rows])

        on_all_cores(fill, _blocks(len(poses)), work=len(poses))
        return out

    def sector_ranges_by_full_scan(self, eta: Floats, noise: RangeNoise | None = None) -> Floats:
        """Reference implementation of `sector_ranges` and `noisy_sector_ranges`: trace every ray.

        Args:
            eta: (n, 3) x, y [m] and heading [rad].

        Returns:
            (n, sectors) [m].
        """
        sectors, range_m = self.spec.sectors, self.spec.range_m
        scans = (
            self.points(pose, noise=None if noise is None else noise.of(np.array([row])))
            for row, pose in enumerate(eta)
        )
        return np.array([nearest_in_sectors(points, sectors, range_m) for points in scans])

    def points(self, pose: Floats, every: int = 1, *, noise: RangeNoise | None = None) -> Floats:
        """Return the points (k, 3) of a scan from one pose (3,), in the body frame [m].

        Args:
            every: trace every n-th ray.
            noise: of one row, for a scan of all rays.
        """
        rays = self.rays
        origins, directions = rays.origins[::every], rays.directions[::every]
        hits = self._volumes.trace(pose, origins, directions, rays.reach[::every])
        if noise is not None:
            hits = noisy_hits(hits, noise.seeds[0], noise.sigma_m[0], noise.lost_returns[0])
        seen = np.isfinite(hits)
        return origins[seen] + hits[seen, None] * directions[seen]


@lru_cache(maxsize=4)
def _shells(spec: SpinningLidars) -> ShellTable:
    """Return the table of rays by shells, which does not depend on the harbor."""

    def build() -> Arrays:
        rays = Rays.from_spec(spec)
        beams = rays.origins, rays.directions, rays.reach, rays.channel
        return ShellTable.build(*beams, spec.sectors, spec.range_m)._asdict()

    inputs = [spec.model_dump_json().encode(), _source(geometry, shell_table, height_grid)]
    return ShellTable(**cached("LiDAR rays", inputs, build))


def _source(*modules: ModuleType) -> bytes:
    """Return the source code of modules, which is part of the key of cached tables."""
    return b"".join(Path(str(module.__file__)).read_bytes() for module in modules)


def _blocks(rows: int) -> list[slice]:
    """Split rows into blocks for all cores: smaller and smaller ones, so that the cores end at the same time.

    Guided self-scheduling after Polychronopoulos and Kuck (1987): half of an equal share of what is left.
    """
    if usable_cores() == 1:
        return [slice(rows)]
    blocks, first = list[slice](), 0
    while first < rows:
        last = first + math.ceil((rows - first) / (2 * usable_cores()))
        blocks.append(slice(first, last))
        first = last
    return blocks
