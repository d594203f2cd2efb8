"""The fast LiDAR scan: exact branch and bound over shells around the boat.

Only the nearest return of each sector is needed. The scan therefore proceeds outward from the boat, shell by
shell (rings of growing radius, divided into narrow bins of azimuth), and stops in a sector once its nearest
return is nearer than the shell. A table in the body frame, built once per set of sensors, lists the rays that
cross each cell of a shell and their bands of height. Rays that pass above or below everything in the harbor
near a cell are skipped there, as is open water. The other rays are traversed through the fine grid of the
harbor. A ray that hits something nearer than the nearest return so far is traversed again from its origin,
because something else may be hit first.

Hits are computed by the same `hit_triangle` as in the ray tracer: the ranges are equal to the last bit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import compiled
from dockctl.geometry import Bools, Floats, sector_index
from dockctl.sim.lidar.height_grid import (
    SLACK_M,
    HeightGrid,
    Indices,
    Line,
    band_at,
    bands_near,
    bits,
    distance_at,
    first_hit,
)
from dockctl.sim.lidar.raycast import MISS, compiled_bare

Ints = NDArray[np.int32]
Runs = NDArray[np.void]
Pose = tuple[float, float, float, float]  # x, y [m], cosine and sine of the heading

BINS_PER_SECTOR = 32
SHELL_GROWTH = 1.03
SHELL_STEP_M = 0.02
CORE_CELL_M = 0.25
CORE_STEP_M = 0.05
# From the center of a core cell to the rays that are added to it by a point every step.
CORE_REACH_M = CORE_CELL_M / math.sqrt(2) + CORE_STEP_M


RUN = np.dtype([("first", np.uint32), ("length", np.uint16), ("low", np.uint8), ("high", np.uint8)])


sector_of = compiled()(sector_index)


class ShellTable(NamedTuple):
    """The rays that cross each cell of the shells, in the body frame.

    Shell k is between ``radii[k]`` and ``radii[k + 1]``. Inside ``radii[0]`` is the core, which contains all
    sensors and where rays may also run inward. Cell ``k * bins + bin`` has the runs
    ``starts[cell]:starts[cell + 1]``, the lowest first; a run is a sequence of neighboring rays with their
    bands of height in the cell. The cells of the core are squares and follow those of the shells.

    Attributes:
        origins: (sensors, 3) origins of the rays [m].
        sensor: (k,) index of the origin of a ray.
        rays: (k, 4) direction and reach [m].
        radii: (shells + 1,) [m].
        bins: (bins, 2) cosine and sine of the center azimuth of each bin.
        half_diagonals: (shells,) from the center of a cell to its farthest corner [m].
        starts, runs: the runs: first ray, number of rays, lowest and highest band.
        core: (cells, 2) centers of the core cells [m], the innermost first.
        core_sectors: (cells, 2) first and last sector of the rays in a core cell, modulo the number of
            sectors.
        shell_at: (k,) the first shell that is not entirely within each multiple of `SHELL_STEP_M`.
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
    core_sectors: Ints
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
        azimuth = np.arctan2(core[:, 1], core[:, 0]) + np.pi
        edges = np.column_stack([azimuth - half_width, azimuth + half_width]) * (sectors / (2 * np.pi))
        edges[half_width > 1.5] = 0, sectors - 1
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
            core_sectors=np.floor(edges).astype(np.int32),
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


def work_arrays(table: ShellTable) -> tuple[Ints, Ints, Bools]:
    """Return the work arrays of `sector_ranges`; every thread needs its own."""
    shells, bins, rays = len(table.radii) - 1, len(table.bins), len(table.rays)
    return np.empty(shells, np.int32), np.empty(bins, np.int32), np.empty(rays, np.bool_)


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

    If `runs` is empty, runs are counted in `places`; otherwise they are written from `places` on.
    """
    shells = len(radii) - 1
    last = np.full(len(places), -2, np.int32)  # last ray added to each cell
    width = 2 * math.pi / bins
    for ray in range(len(rays)):
        origin, (dx, dy, dz, reach) = origins[ray], rays[ray]
        ox, oy, oz = origin
        joined = ray > 0 and channel[ray - 1] == channel[ray]
        t = min(_exit_parameter(origin, rays[ray], radii[0]), reach)
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
            t_out = min(_exit_parameter(origin, rays[ray], radii[shell + 1]), reach)
            theta_out = math.atan2(oy + t_out * dy, ox + t_out * dx)
            low, high = _turn(theta, theta_out)
            for index in range(math.floor((low + math.pi) / width), math.floor((high + math.pi) / width) + 1):
                cell = shell * bins + index % bins
                _add(ray, cell, joined, oz + dz * t, oz + dz * t_out, last, places, runs)
            t, theta = t_out, theta_out


@compiled()
def _turn(begin: float, end: float) -> tuple[float, float]:
    """Return the lower and upper azimuth of the smaller angle between two azimuths, with a margin."""
    turn = end - begin
    turn -= 2 * math.pi * math.floor(turn / (2 * math.pi) + 0.5)
    return min(begin, begin + turn) - 1e-7, max(begin, begin + turn) + 1e-7


@compiled()
def _add(
    ray: int, cell: int, joined: bool, z: float, z_out: float, last: Ints, places: Ints, runs: Runs
) -> None:
    """Add one ray, which passes the cell between the heights `z` and `z_out` [m], to the cell.

    It extends the last run of the cell if it is `joined` to the last ray of that run.
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
def _exit_parameter(origin: Floats, ray: Floats, radius: float) -> float:
    """Return the ray parameter at which a ray leaves the circle of `radius`; NaN if it does not enter it."""
    h2 = ray[0] * ray[0] + ray[1] * ray[1]
    if h2 < 1e-12:
        return MISS
    b = origin[0] * ray[0] + origin[1] * ray[1]
    c = origin[0] * origin[0] + origin[1] * origin[1]
    return float((math.sqrt(b * b - h2 * (c - radius * radius)) - b) / h2)


@compiled_bare
def sector_ranges(
    table: ShellTable,
    grid: HeightGrid,
    levels: Levels,
    range_m: float,
    poses: Floats,
    first: Ints,
    following: Ints,
    traced: Bools,
    out: Floats,
) -> None:
    """Write the range of the nearest return in each sector [m] from the poses (n, 3) to `out` (n, sectors).

    Work arrays: `first` (shells,) and `following` (bins,) are lists of the bins to look up in each shell,
    ended by -1; `traced` (rays,) marks rays that have been traversed through the core.
    """
    # Local names: the compiler does not read them from the tuple again in the inner loops.
    radii, middles = table.radii, table.bins
    sectors, shells = out.shape[1], len(radii) - 1
    bins = len(middles) // sectors
    widening = 1.0 + math.pi / len(middles)  # the half-width of a bin grows with the radius
    for row in range(len(poses)):
        x, y = poses[row, 0], poses[row, 1]
        c, s = math.cos(poses[row, 2]), math.sin(poses[row, 2])
        pose, best = (x, y, c, s), out[row]
        best[:] = range_m
        if bands_near(grid, levels.whole_core, x, y) != 0:
            _search_core(table, grid, levels.core_cell, pose, traced, best)
        first[:] = -1
        for index in range(len(middles)):
            following[index] = index - 1
        nearest = shell_of(table, distance_at(grid, x, y))
        if nearest < shells:
            first[nearest] = len(middles) - 1
        for shell in range(nearest, shells):
            inner, outer = radii[shell], radii[shell + 1]
            middle = (inner + outer) / 2
            index = first[shell]
            while index >= 0:
                after, sector = following[index], index // bins
                if best[sector] > inner:
                    across, along = middle * middles[index, 0], middle * middles[index, 1]
                    wx, wy = x + (c * across - s * along), y + (s * across + c * along)
                    near = bands_near(grid, levels.shell_cells[shell], wx, wy)
                    upcoming = shell + 1
                    if near == 0:
                        clear = (distance_at(grid, wx, wy) + middle) / widening
                        upcoming = max(upcoming, shell_of(table, clear))
                    else:
                        cell = shell * len(middles) + index
                        _visit(table, grid, cell, near, inner, outer, sector, pose, best)
                    if upcoming < shells:
                        following[index] = first[upcoming]
                        first[upcoming] = index
                index = after


@compiled(inline="always")
def shell_of(table: ShellTable, radius: float) -> int:
    """Return the first shell, or an earlier one, that is not entirely within a radius [m]."""
    return int(table.shell_at[min(int(radius / SHELL_STEP_M), len(table.shell_at) - 1)])


@compiled_bare
def _search_core(
    table: ShellTable, grid: HeightGrid, level: int, pose: Pose, traced: Bools, best: Floats
) -> None:
    """Traverse the rays of the core cells with obstacles nearby, from their origins through the core."""
    x, y, c, s = pose
    shell_cells = len(table.bins) * (len(table.radii) - 1)
    traced[:] = False
    for index in range(len(table.core)):
        ahead, lateral = table.core[index, 0], table.core[index, 1]
        first, last = table.core_sectors[index]
        if math.sqrt(ahead * ahead + lateral * lateral) - CORE_REACH_M > _farthest(best, first, last):
            continue
        near = bands_near(grid, level, x + (c * ahead - s * lateral), y + (s * ahead + c * lateral))
        if near == 0:
            continue
        cell = shell_cells + index
        for slot in range(table.starts[cell], table.starts[cell + 1]):
            run = table.runs[slot]
            if near >> run.low == 0:  # this run and the following ones are above everything
                break
            if bits(run.low, run.high) & near == 0:
                continue
            farthest = min(_farthest(best, 0, len(best) - 1), table.radii[0])
            origin = table.origins[table.sensor[run.first]]
            for number in range(run.first, run.first + run.length):
                if traced[number]:
                    continue
                traced[number] = True
                ray = table.rays[number]
                leaves = _exit_parameter(origin, ray, farthest)
                if not leaves >= 0.0:  # a ray from outside of `farthest` that does not enter it
                    continue
                end = min(leaves + 1e-7, ray[3])
                z, z_end = origin[2], origin[2] + end * ray[2]
                bands = bits(band_at(min(z, z_end)), band_at(max(z, z_end)))
                t = first_hit(grid, _in_world(origin, ray, pose), 0.0, end, bands)
                if t <= end:
                    rho, sector = _polar(origin, ray, t, len(best))
                    best[sector] = min(best[sector], rho)


@compiled(inline="always")
def _farthest(best: Floats, first: int, last: int) -> float:
    """Return the farthest of the nearest returns [m] of the sectors from `first` to `last`."""
    farthest = 0.0
    for sector in range(first, last + 1):
        farthest = max(farthest, best[sector % len(best)])
    return farthest


# Inlined: a call would copy the fields of all tables, which takes longer than most visits.
@compiled(_nrt=False, forceinline=True)
def _visit(
    table: ShellTable,
    grid: HeightGrid,
    cell: int,
    near: int,
    inner: float,
    outer: float,
    bin_sector: int,
    pose: Pose,
    best: Floats,
) -> None:
    """Traverse the rays of a cell in the bands `near` between two radii, and update the nearest returns."""
    runs, rays, core = table.runs, table.rays, table.radii[0]
    for slot in range(table.starts[cell], table.starts[cell + 1]):
        run = runs[slot]
        if near >> run.low == 0:  # this run and the following ones are above everything
            break
        bands = bits(run.low, run.high)
        if bands & near == 0:
            continue
        origin = table.origins[table.sensor[run.first]]
        farthest = min(outer, best[bin_sector])
        if farthest <= inner:
            return
        for index in range(run.first, run.first + run.length):
            ray = rays[index]
            begin = _exit_parameter(origin, ray, inner) - 1e-7
            end = min(_exit_parameter(origin, ray, farthest) + 1e-7, ray[3])
            if begin > end:
                continue
            t = first_hit(grid, _in_world(origin, ray, pose), begin, end, bands)
            if t > end:
                continue
            rho, sector = _polar(origin, ray, t, len(best))
            if rho >= best[sector]:
                continue
            clear = _clear_up_to(origin, ray, core, t, best)
            if clear < inner:  # something else may be hit first
                t = _trace(grid, origin, ray, clear, t, pose)
                rho, sector = _polar(origin, ray, t, len(best))
            best[sector] = min(best[sector], rho)


@compiled_bare
def _trace(grid: HeightGrid, origin: Floats, ray: Floats, clear: float, t: float, pose: Pose) -> float:
    """Return the first hit of a ray between a radius [m] and its parameter t."""
    begin = _exit_parameter(origin, ray, clear) - 1e-7 if clear > 0.0 else 0.0
    return min(t, first_hit(grid, _in_world(origin, ray, pose), begin, t, -1))


@compiled_bare
def _clear_up_to(origin: Floats, ray: Floats, core: float, t: float, best: Floats) -> float:
    """Return the radius up to which a ray is known to hit nothing before its parameter t [m].

    In the previous shells it was traversed through each sector up to the nearest return of that sector, and a
    hit would have become such a return. In the core it may pass through any sector.
    """
    for sector in range(len(best)):
        if best[sector] <= core:
            return 0.0
    t_core = _exit_parameter(origin, ray, core)
    theta = math.atan2(origin[1] + t_core * ray[1], origin[0] + t_core * ray[0])
    low, high = _turn(theta, math.atan2(origin[1] + t * ray[1], origin[0] + t * ray[0]))
    width = 2 * math.pi / len(best)
    clear = MISS
    for sector in range(math.floor((low + math.pi) / width), math.floor((high + math.pi) / width) + 1):
        clear = min(clear, best[sector % len(best)])
    return clear


@compiled(inline="always")
def _in_world(origin: Floats, ray: Floats, pose: Pose) -> Line:
    x, y, c, s = pose
    return (
        x + (c * origin[0] - s * origin[1]),
        y + (s * origin[0] + c * origin[1]),
        origin[2],
        c * ray[0] - s * ray[1],
        s * ray[0] + c * ray[1],
        ray[2],
    )


@compiled()
def _polar(origin: Floats, ray: Floats, t: float, sectors: int) -> tuple[float, int]:
    """Return the radius [m] and the sector of a point of a ray."""
    px, py = origin[0] + t * ray[0], origin[1] + t * ray[1]
    return math.sqrt(px * px + py * py), sector_of(px, py, sectors)
