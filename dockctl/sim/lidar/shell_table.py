"""The rays of all LiDARs, by the cells around the boat that they cross, in the body frame.

A table is built once per set of sensors. It also gives the level of the harbor grid that covers each cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import compiled
from dockctl.geometry import Floats, sector_index
from dockctl.sim.lidar.height_grid import SLACK_M, HeightGrid, Indices, band_at, floor
from dockctl.sim.lidar.raycast import MISS

Ints = NDArray[np.int32]
Runs = NDArray[np.void]

BINS_PER_SECTOR = 32
SHELL_GROWTH = 1.025
SHELL_STEP_M = 0.02
CORE_CELL_M = 0.08
CORE_STEP_M = 0.04  # so that the reach is the radius of the finest level of the grid, 0.1 m
# Maximum distance from the center of a core cell to the rays that are added to it, one point per step.
CORE_REACH_M = CORE_CELL_M / math.sqrt(2) + CORE_STEP_M
RUN = np.dtype([("first", np.uint32), ("length", np.uint16), ("low", np.uint8), ("high", np.uint8)])


sector_at = compiled()(sector_index)


class ShellTable(NamedTuple):
    """The rays that cross each cell of the shells, in the body frame.

    Shell k is between ``radii[k]`` and ``radii[k + 1]``. Inside ``radii[0]`` is the core, which contains all
    sensors and in which rays may also run inward. Cell ``k * bins + bin`` has the runs
    ``starts[cell]:starts[cell + 1]``, lowest first; a run is a sequence of neighboring rays with their
    height bands in the cell. The cells of the core are squares and follow those of the shells.

    Attributes:
        origins: (sensors, 3) origins of the rays [m].
        sensor: (k,) index of the origin of a ray.
        rays: (k, 4) direction and reach [m].
        radii: (shells + 1,) [m].
        bins: (bins, 2) cosine and sine of the center azimuth of each bin.
        half_diagonals: (shells,) from the center of a cell to its farthest corner [m].
        starts, runs: the runs: first ray, number of rays, lowest and highest band.
        core: (cells, 2) centers of the core cells [m], the innermost first.
        core_edges: (cells, 2) minimum and maximum azimuth of the rays in a core cell [rad].
        shell_at: (k,) for each multiple of `SHELL_STEP_M`, the first shell not entirely within that radius.
    """

    origins: Floats
    sensor: NDArray[np.uint8]
    rays: Floats
    radii: Floats
    bins: Floats
    half_diagonals: Floats
    starts: Indices
    runs: Runs
    core: Floats
    core_edges: Floats
    shell_at: NDArray[np.int16]

    @classmethod
    def build(
        cls, origins: Floats, directions: Floats, reach: Floats, channel: Ints, sectors: int, range_m: float
    ) -> ShellTable:
        """Return the table of rays (k, 3), with their lengths `reach` (k,) [m] and channels (k,)."""
        inner = 1.05 * float(np.hypot(origins[:, 0], origins[:, 1]).max()) + 0.05
        shells = max(1, math.ceil(math.log(range_m / inner, SHELL_GROWTH)) + 1)
        radii: Floats = inner * np.float64(SHELL_GROWTH) ** np.arange(shells + 1)
        count = sectors * BINS_PER_SECTOR
        middles = (np.arange(count) + 0.5) * (2 * np.pi / count) - np.pi
        middle_radius, half_angle = (radii[:-1] + radii[1:]) / 2, np.pi / count
        corner = np.stack([radii[1:] * math.cos(half_angle), radii[1:] * math.sin(half_angle)])
        half_diagonals = np.hypot(corner[0] - middle_radius, corner[1]) + SLACK_M
        steps = np.arange(math.ceil(radii[-1] / SHELL_STEP_M) + 1)
        places, sensor = np.unique(origins, axis=0, return_inverse=True)
        rays = np.column_stack([directions, reach])
        side = math.ceil(inner / CORE_CELL_M)
        middle = (np.arange(2 * side) + 0.5 - side) * CORE_CELL_M
        core = np.stack(np.meshgrid(middle, middle), axis=-1).reshape(-1, 2)
        order = np.argsort(np.hypot(core[:, 0], core[:, 1]), kind="stable")
        rank = np.argsort(order).astype(np.int32)
        core = core[order]
        half_width = np.arcsin(
            np.minimum(CORE_REACH_M / np.maximum(np.hypot(core[:, 0], core[:, 1]), 1e-9), 1.0)
        )
        azimuth = np.arctan2(core[:, 1], core[:, 0])
        edges = np.column_stack([azimuth - half_width, azimuth + half_width])
        edges[half_width > 1.5] = -np.pi, np.pi
        counts = np.zeros(shells * count + len(core) + 1, np.int32)
        _gather(origins, rays, channel, radii, count, side, rank, counts, np.empty(0, RUN))
        starts = np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.uint32)
        runs = np.zeros(starts[-1], RUN)
        _gather(origins, rays, channel, radii, count, side, rank, starts[:-1].astype(np.int32), runs)
        cell = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
        runs = runs[np.lexsort([runs["low"], cell])]
        return cls(
            origins=places,
            sensor=sensor.astype(np.uint8),
            rays=rays,
            radii=radii,
            bins=np.column_stack([np.cos(middles), np.sin(middles)]),
            half_diagonals=half_diagonals,
            starts=starts,
            runs=runs,
            core=core,
            core_edges=edges,
            shell_at=np.searchsorted(radii[1:], steps * SHELL_STEP_M, side="right").astype(np.int16),
        )


class Levels(NamedTuple):
    """The levels of a `HeightGrid` that cover the whole core, one core cell, and a cell of each shell."""

    whole_core: int
    core_cell: int
    shell_cells: Ints

    @classmethod
    def build(cls, table: ShellTable, grid: HeightGrid) -> Levels:
        radii = needed_radii(table)
        levels = np.searchsorted(grid.radii, radii).astype(np.int32)
        return cls(int(levels[0]), int(levels[1]), levels[2:])


def needed_radii(table: ShellTable) -> Floats:
    """Return the radii [m] for which a grid needs a level: the core, a core cell, a cell of each shell."""
    return np.concatenate([[table.radii[0], CORE_REACH_M], table.half_diagonals])


@compiled()
def _gather(
    origins: Floats,
    rays: Floats,
    channel: Ints,
    radii: Floats,
    bins: int,
    core_side: int,
    core_rank: Ints,
    places: Ints,
    runs: Runs,
) -> None:
    """Add every ray to the cells that it crosses, extending runs of neighboring rays.

    If `runs` is empty, runs are counted in `places`; otherwise they are written starting at `places`.
    """
    shells = len(radii) - 1
    last = np.full(len(places), -2, np.int32)  # last ray added to each cell
    for ray in range(len(rays)):
        origin, (dx, dy, dz, reach) = origins[ray], rays[ray]
        ox, oy, oz = origin
        joined = ray > 0 and channel[ray - 1] == channel[ray]
        t = min(exit_parameter(origin, rays[ray], radii[0]), reach)
        steps = math.ceil(t / CORE_STEP_M) + 1
        for step in range(steps):
            begin, end = t * step / steps, t * (step + 1) / steps
            middle = (begin + end) / 2
            ix = min(int((ox + middle * dx) / CORE_CELL_M + core_side), 2 * core_side - 1)
            iy = min(int((oy + middle * dy) / CORE_CELL_M + core_side), 2 * core_side - 1)
            cell = shells * bins + core_rank[iy * 2 * core_side + ix]
            _add(ray, cell, joined, oz + dz * begin, oz + dz * end, last, places, runs)
        theta = math.atan2(oy + t * dy, ox + t * dx)
        for shell in range(shells):
            if t >= reach:
                break
            t_out = min(exit_parameter(origin, rays[ray], radii[shell + 1]), reach)
            theta_out = math.atan2(oy + t_out * dy, ox + t_out * dx)
            low, high = turn(theta, theta_out)
            lowest, highest = sectors_between(low, high, bins)
            for index in range(lowest, highest + 1):
                cell = shell * bins + index % bins
                _add(ray, cell, joined, oz + dz * t, oz + dz * t_out, last, places, runs)
            t, theta = t_out, theta_out


@compiled(inline="always")
def sectors_between(low: float, high: float, sectors: int) -> tuple[int, int]:
    """Return the first and last sector, modulo `sectors`, between two azimuths, which may be beyond ±pi."""
    return _unwrapped_sector(low, sectors), _unwrapped_sector(high, sectors)


@compiled(inline="always")
def _unwrapped_sector(azimuth: float, sectors: int) -> int:
    turns = floor((azimuth + math.pi) / (2 * math.pi))
    return int(sector_at(azimuth - 2 * math.pi * turns, sectors)) + turns * sectors


@compiled()
def turn(begin: float, end: float) -> tuple[float, float]:
    """Return the lower and upper end of the smaller angle between two azimuths [rad], with a margin."""
    turn = end - begin
    turn -= 2 * math.pi * math.floor(turn / (2 * math.pi) + 0.5)
    return min(begin, begin + turn) - 1e-7, max(begin, begin + turn) + 1e-7


@compiled()
def _add(
    ray: int, cell: int, joined: bool, z: float, z_out: float, last: Ints, places: Ints, runs: Runs
) -> None:
    """Add one ray, which passes the cell between the heights `z` and `z_out` [m], to the cell.

    The ray extends the last run of the cell if it is `joined` to the last ray of that run.
    """
    same, extends_run = last[cell] == ray, joined and last[cell] == ray - 1
    last[cell] = ray
    if not (same or extends_run):
        places[cell] += 1
    if len(runs) == 0:
        return
    low, high = band_at(min(z, z_out) - SLACK_M), band_at(max(z, z_out) + SLACK_M)
    run = runs[places[cell] - 1]
    if not (same or extends_run):
        run.first, run.low, run.high = ray, low, high
    if not same:
        run.length += 1
    run.low, run.high = min(run.low, low), max(run.high, high)


@compiled(inline="always")
def exit_parameter(origin: Floats, ray: Floats, radius: float) -> float:
    """Return the ray parameter at which a ray leaves the circle of `radius`; NaN if it does not enter it.

    Args:
        origin: x and y of a point of the ray [m]; further components are ignored.
        ray: direction, with the same components.
        radius: of the circle around the origin of the frame [m].
    """
    h2 = ray[0] * ray[0] + ray[1] * ray[1]
    if h2 < 1e-12:
        return MISS
    b = origin[0] * ray[0] + origin[1] * ray[1]
    c = origin[0] * origin[0] + origin[1] * origin[1]
    return float((math.sqrt(b * b - h2 * (c - radius * radius)) - b) / h2)
