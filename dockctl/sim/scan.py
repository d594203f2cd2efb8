"""The fast LiDAR scan: an exact branch and bound over rings of water around the boat.

Only the nearest return of each sector matters, so the scan looks outwards from the boat, ring by ring (shells
of growing radius cut into narrow bins of azimuth), and stops in a sector once its nearest return is nearer
than the ring. A table in the body frame, made once for a set of sensors, tells which rays cross a cell of the
rings and in which bands of height; rays that pass above or below all of the harbor near a cell are left
out there, and so are stretches of open water. The rays that remain are walked through the fine grid of the
harbor; a ray that hits something nearer than the sector's best is walked again from its origin, because
something else may stop it first.

A hit is found by the same `hit_triangle` as in the plain tracer: the ranges equal the oracle's bit for bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dockctl.sim.heightgrid import (
    SLACK_M,
    Bands,
    HeightGrid,
    Line,
    bands_between,
    bands_near,
    distance_at,
    first_hit,
)
from dockctl.sim.raycast import MISS, njit_bare

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Pose = tuple[float, float, float, float]  # x, y [m], cosine and sine of the heading

BINS_PER_SECTOR = 32
SHELL_GROWTH = 1.03
CORE_CELL_M = 0.25
CORE_STEP_M = 0.05
# From the middle of a core's cell to the rays that are entered there by a point every step.
CORE_REACH_M = CORE_CELL_M / math.sqrt(2) + CORE_STEP_M


@njit(cache=True, nogil=True)
def sector_of(x: float, y: float, sectors: int) -> int:
    """Return in which of the equal sectors of azimuth over [-pi, pi] the body-frame point (x, y) lies."""
    return min(int((math.atan2(y, x) + math.pi) / (2 * math.pi) * sectors), sectors - 1)


class ShellTable(NamedTuple):
    """Which rays cross which cell of the rings, in the body frame.

    Shell k lies between ``radii[k]`` and ``radii[k + 1]``; within ``radii[0]`` lies the core, around all the
    sensors, where rays need not run outwards. Cell ``k * bins + bin`` has the runs
    ``starts[cell]:starts[cell + 1]``; a run is a row of neighbouring rays. The core's cells are squares, and
    come after those of the shells.

    Attributes:
        rays: (k, 10) origin, direction, reach, and the coefficients of rho(t)^2 = h2 t^2 + 2 b t + c.
        radii: (shells + 1,) [m].
        bins: (bins, 2) cosine and sine of the middle azimuth of each bin.
        half_diagonals: (shells,) from a cell's middle to its farthest corner [m].
        starts, first, length, bands: the runs, with the bands of height that each passes in its cell.
        core: (cells, 2) middles of the core's cells [m].
    """

    rays: Floats
    radii: Floats
    bins: Floats
    half_diagonals: Floats
    starts: Ints
    first: Ints
    length: Ints
    bands: Bands
    core: Floats

    @classmethod
    def of(
        cls, origins: Floats, directions: Floats, reach: Floats, channel: Ints, sectors: int, range_m: float
    ) -> ShellTable:
        """Make the table for (k, 3) rays, their (k,) reach [m] and the (k,) channel that each belongs to."""
        inner = 1.05 * float(np.hypot(origins[:, 0], origins[:, 1]).max()) + 0.05
        shells = max(1, math.ceil(math.log(range_m / inner, SHELL_GROWTH)) + 1)
        radii: Floats = inner * np.float64(SHELL_GROWTH) ** np.arange(shells + 1)
        count = sectors * BINS_PER_SECTOR
        middles = (np.arange(count) + 0.5) * (2 * np.pi / count) - np.pi
        middle_radius, half_angle = (radii[:-1] + radii[1:]) / 2, np.pi / count
        corner = np.stack([radii[1:] * math.cos(half_angle), radii[1:] * math.sin(half_angle)])
        half_diagonals = np.hypot(corner[0] - middle_radius, corner[1]) + SLACK_M
        xy, d = origins[:, :2], directions[:, :2]
        quadratic = [np.sum(d * d, axis=1), np.sum(xy * d, axis=1), np.sum(xy * xy, axis=1)]
        rays = np.column_stack([origins, directions, reach, *quadratic])
        side = math.ceil(inner / CORE_CELL_M)
        places = (np.arange(2 * side) + 0.5 - side) * CORE_CELL_M
        core = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
        counts = np.zeros(shells * count + len(core) + 1, np.int32)
        nothing = np.empty(0, np.int32)
        _gather(rays, channel, radii, count, side, counts, nothing, nothing, np.empty(0, np.int64))
        starts = np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.int32)
        first, length = np.empty(starts[-1], np.int32), np.zeros(starts[-1], np.int32)
        bands = np.zeros(starts[-1], np.int64)
        _gather(rays, channel, radii, count, side, starts[:-1].copy(), first, length, bands)
        return cls(
            rays=rays,
            radii=radii,
            bins=np.column_stack([np.cos(middles), np.sin(middles)]),
            half_diagonals=half_diagonals,
            starts=starts,
            first=first,
            length=length,
            bands=bands,
            core=core,
        )


class Levels(NamedTuple):
    """Which level of a `HeightGrid` covers the whole core, one cell of the core, and a cell of each shell."""

    whole_core: int
    core_cell: int
    shell_cells: Ints

    @classmethod
    def of(cls, table: ShellTable, grid: HeightGrid) -> Levels:
        radii = needed_radii(table)
        levels = np.searchsorted(grid.radii, radii).astype(np.int32)
        return cls(int(levels[0]), int(levels[1]), levels[2:])


def needed_radii(table: ShellTable) -> Floats:
    """Return the radii within which a grid is asked what stands: the core's, its cells', the shells' [m]."""
    return np.concatenate([[table.radii[0], CORE_REACH_M], table.half_diagonals])


@njit(cache=True)
def _gather(
    rays: Floats,
    channel: Ints,
    radii: Floats,
    bins: int,
    core_side: int,
    places: Ints,
    first: Ints,
    length: Ints,
    bands: Bands,
) -> None:
    """Enter every ray in the cells that it crosses, growing runs of neighbours.

    Runs are only counted in `places` where `first` is empty; otherwise they are filled in from there on.
    """
    shells = len(radii) - 1
    last = np.full(len(places), -2, np.int32)  # the last ray entered in a cell
    width = 2 * math.pi / bins
    for ray in range(len(rays)):
        ox, oy, oz, dx, dy, dz, reach = rays[ray, :7]
        joined = ray > 0 and channel[ray - 1] == channel[ray]
        t = min(_leaves(rays[ray], radii[0]), reach)
        steps = math.ceil(t / CORE_STEP_M) + 1
        for step in range(steps):
            here, there = t * step / steps, t * (step + 1) / steps
            middle = (here + there) / 2
            ix = min(int((ox + middle * dx) / CORE_CELL_M + core_side), 2 * core_side - 1)
            iy = min(int((oy + middle * dy) / CORE_CELL_M + core_side), 2 * core_side - 1)
            cell = shells * bins + iy * 2 * core_side + ix
            passed = _passed(oz + dz * here, oz + dz * there)
            _enter(ray, cell, joined, passed, last, places, first, length, bands)
        theta = math.atan2(oy + t * dy, ox + t * dx)
        for shell in range(shells):
            if t >= reach:
                break
            t_out = min(_leaves(rays[ray], radii[shell + 1]), reach)
            theta_out = math.atan2(oy + t_out * dy, ox + t_out * dx)
            turn = theta_out - theta
            turn -= 2 * math.pi * math.floor(turn / (2 * math.pi) + 0.5)
            low = min(theta, theta + turn) - 1e-7
            high = max(theta, theta + turn) + 1e-7
            passed = _passed(oz + dz * t, oz + dz * t_out)
            for index in range(math.floor((low + math.pi) / width), math.floor((high + math.pi) / width) + 1):
                cell = shell * bins + index % bins
                _enter(ray, cell, joined, passed, last, places, first, length, bands)
            t, theta = t_out, theta_out


@njit(cache=True, inline="always")
def _passed(z: float, z_out: float) -> int:
    return bands_between(min(z, z_out) - SLACK_M, max(z, z_out) + SLACK_M)


@njit(cache=True)
def _enter(
    ray: int,
    cell: int,
    joined: bool,
    passed: int,
    last: Ints,
    places: Ints,
    first: Ints,
    length: Ints,
    bands: Bands,
) -> None:
    """Enter one ray in one cell; it lengthens the cell's last run if `joined` to that run's last ray."""
    same, joins = last[cell] == ray, joined and last[cell] == ray - 1
    last[cell] = ray
    if not (same or joins):
        places[cell] += 1
    if len(first) == 0:
        return
    run = places[cell] - 1
    if not (same or joins):
        first[run] = ray
    if not same:
        length[run] += 1
    bands[run] |= passed


@njit(cache=True, nogil=True, inline="always")
def _leaves(ray: Floats, radius: float) -> float:
    """Return the ray parameter where a ray that begins within `radius` leaves that circle."""
    h2, b, c = ray[7], ray[8], ray[9]
    if h2 < 1e-12:
        return MISS
    return float((math.sqrt(b * b - h2 * (c - radius * radius)) - b) / h2)


@njit_bare
def sector_ranges(
    table: ShellTable,
    grid: HeightGrid,
    levels: Levels,
    range_m: float,
    poses: Floats,
    skip_below: Floats,
    out: Floats,
) -> None:
    """Fill `out` (n, sectors) with the nearest return of each sector [m] from the poses (n, 3).

    `skip_below` (bins,) is scratch space: the radius below which a bin is known to be empty [m].
    """
    # Named once, so that the compiler need not read them from the tuple again in the inner loops.
    rays, radii, middles, starts = table.rays, table.radii, table.bins, table.starts
    first, length, run_bands = table.first, table.length, table.bands
    sectors, bins, shells = out.shape[1], len(middles), len(radii) - 1
    widening = 1.0 + math.pi / bins  # a bin's half width grows with the radius
    for row in range(len(poses)):
        x, y = poses[row, 0], poses[row, 1]
        c, s = math.cos(poses[row, 2]), math.sin(poses[row, 2])
        pose, best = (x, y, c, s), out[row]
        best[:] = range_m
        skip_below[:] = 0.0
        if bands_near(grid, levels.whole_core, x, y) != 0:
            _search_core(table, grid, levels.core_cell, pose, best)
        for shell in range(shells):
            inner, outer = radii[shell], radii[shell + 1]
            middle = (inner + outer) / 2
            looking = False
            for index in range(bins):
                sector = index * sectors // bins
                if best[sector] <= inner:
                    continue
                looking = True
                if skip_below[index] >= outer:
                    continue
                across, along = middle * middles[index, 0], middle * middles[index, 1]
                wx, wy = x + (c * across - s * along), y + (s * across + c * along)
                near = bands_near(grid, levels.shell_cells[shell], wx, wy)
                if near == 0:
                    skip_below[index] = (distance_at(grid, wx, wy) + middle) / widening
                    continue
                cell = shell * bins + index
                for run in range(starts[cell], starts[cell + 1]):
                    if run_bands[run] & near == 0:
                        continue
                    for ray in range(first[run], first[run] + length[run]):
                        _visit(grid, rays[ray], inner, min(outer, best[sector]), pose, best)
            if not looking:
                break


@njit_bare
def _search_core(table: ShellTable, grid: HeightGrid, level: int, pose: Pose, best: Floats) -> None:
    """Visit every ray in the cells of the core near which anything stands."""
    x, y, c, s = pose
    shell_cells = len(table.bins) * (len(table.radii) - 1)
    for index in range(len(table.core)):
        ahead, aside = table.core[index, 0], table.core[index, 1]
        near = bands_near(grid, level, x + (c * ahead - s * aside), y + (s * ahead + c * aside))
        cell = shell_cells + index
        for run in range(table.starts[cell], table.starts[cell + 1]):
            if table.bands[run] & near:
                for ray in range(table.first[run], table.first[run] + table.length[run]):
                    _visit(grid, table.rays[ray], 0.0, table.radii[0], pose, best)


@njit(cache=True, nogil=True, inline="always")
def _visit(grid: HeightGrid, ray: Floats, inner: float, outer: float, pose: Pose, best: Floats) -> None:
    """Walk one ray between two radii, and let its closest hit count if it hits something there.

    What is hit there need not be hit first: before it counts, the ray is walked from its origin.
    """
    begin = _leaves(ray, inner) - 1e-7 if inner > 0.0 else 0.0
    end = min(_leaves(ray, outer) + 1e-7, ray[6])
    if begin > end:
        return
    line = _in_world(ray, pose)
    t = first_hit(grid, line, begin, end)
    if t <= ray[6] and _improves(ray, t, best):
        t = first_hit(grid, line, 0.0, t)
        px, py = ray[0] + t * ray[3], ray[1] + t * ray[4]
        sector = sector_of(px, py, len(best))
        best[sector] = min(best[sector], math.sqrt(px * px + py * py))


@njit(cache=True, nogil=True, inline="always")
def _in_world(ray: Floats, pose: Pose) -> Line:
    x, y, c, s = pose
    return (
        x + (c * ray[0] - s * ray[1]),
        y + (s * ray[0] + c * ray[1]),
        ray[2],
        c * ray[3] - s * ray[4],
        s * ray[3] + c * ray[4],
        ray[5],
    )


@njit(cache=True, nogil=True)
def _improves(ray: Floats, t: float, best: Floats) -> bool:
    """Tell whether a hit at ray parameter t would be the nearest of its sector so far."""
    px, py = ray[0] + t * ray[3], ray[1] + t * ray[4]
    return bool(math.sqrt(px * px + py * py) < best[sector_of(px, py, len(best))])
