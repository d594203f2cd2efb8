"""The fast LiDAR scan: exact branch and bound over shells around the boat.

Only the nearest return of each sector is needed. The scan therefore proceeds outward from the boat, shell by
shell (rings of growing radius, divided into narrow bins of azimuth), and stops in a sector once its nearest
return is nearer than the shell. A table in the body frame, built once per set of sensors, lists the rays that
cross each cell of a shell and their bands of height. Rays that pass above or below everything in the harbor
near a cell are skipped there, as is open water. A table gives the heights of obstacles in a circle around the
cell; where there are some, the cell itself is checked. The other rays are traced through the fine grid of the
harbor. A ray that hits something nearer than the nearest return so far is traced again from its origin,
because something else may be hit first.

Noise moves the return of a ray along the ray. A hit at radius r can then still become the nearest return if
the nearest one so far is beyond r minus the error, in every sector that the return may move to. The error of
a ray is drawn before it is traced: beyond the nearest return, few errors are large enough. Without noise, the
compiler removes all of this.

Hits are computed by the same `hit_triangle` as in the ray tracer, so the ranges are equal to the last bit.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import compiled
from dockctl.geometry import Bools, Floats
from dockctl.noise import Seeds
from dockctl.sim.lidar.height_grid import (
    SLACK_M,
    HeightGrid,
    Line,
    band_at,
    bands_in,
    bands_near,
    bits,
    distance_at,
    first_hit,
)
from dockctl.sim.lidar.raycast import MISS, compiled_bare
from dockctl.sim.lidar.return_noise import ReturnNoise, error_above, largest_error, share_above
from dockctl.sim.lidar.shell_table import (
    CORE_REACH_M,
    SHELL_STEP_M,
    Levels,
    ShellTable,
    exit_parameter,
    sector_at,
    sectors_between,
    turn,
)

Ints = NDArray[np.int32]
Pose = tuple[float, float, float, float]  # x, y [m], cosine and sine of the heading


def work_arrays(table: ShellTable) -> tuple[Ints, Ints, Bools]:
    """Return the work arrays of `sector_ranges`: (shells,), (bins,), (rays,). Every thread needs its own."""
    shells, bins, rays = len(table.radii) - 1, len(table.bins), len(table.rays)
    return np.empty(shells, np.int32), np.empty(bins, np.int32), np.empty(rays, np.bool_)


@compiled_bare
def sector_ranges(
    table: ShellTable,
    grid: HeightGrid,
    levels: Levels,
    range_m: float,
    poses: Floats,
    noises: tuple[Seeds, Floats, Floats] | None,
    first: Ints,
    following: Ints,
    traced: Bools,
    out: Floats,
) -> None:
    """Write the range of the nearest return in each sector [m] from the poses (n, 3) to `out` (n, sectors).

    The noise consists of the seeds of the scans, standard deviations [m] and fractions of lost returns, (n,)
    each. Work arrays: `first` (shells,) and `following` (bins,) are linked lists of the bins to look up in
    each shell, terminated by -1; `traced` (rays,) marks rays that have been traced through the core.
    """
    # Local names, so that the inner loops do not read them from the tuple again.
    radii, middles = table.radii, table.bins
    sectors, shells = out.shape[1], len(radii) - 1
    bins = len(middles) // sectors
    half_width, bins_per_radian = math.pi / len(middles), len(middles) / (2 * math.pi)
    widening = 1.0 + half_width  # a cell grows with the radius
    for row in range(len(poses)):
        x, y = poses[row, 0], poses[row, 1]
        c, s = math.cos(poses[row, 2]), math.sin(poses[row, 2])
        pose, best = (x, y, c, s), out[row]
        noise = None if noises is None else ReturnNoise(noises[0][row], noises[1][row], noises[2][row])
        error = largest_error(noise)
        best[:] = range_m
        if bands_near(grid, levels.whole_core, x, y) != 0:
            _search_core(table, grid, levels.core_cell, pose, noise, traced, best)
        first[:] = -1
        for index in range(len(middles)):
            following[index] = index - 1
        nearest = shell_of(table, distance_at(grid, x, y))
        if nearest < shells:
            first[nearest] = len(middles) - 1
        for shell in range(nearest, shells):
            inner, outer = radii[shell], radii[shell + 1]
            middle = (inner + outer) / 2
            depth, width = half_sides(inner, outer, half_width)
            margin = 0 if noise is None else math.ceil(angle_of(error, inner, radii[0]) * bins_per_radian)
            index = first[shell]
            while index >= 0:
                after = following[index]
                reached = (index - margin) // bins, (index + margin) // bins
                if farthest_of(best, reached) + error > inner:
                    across, along = middle * middles[index, 0], middle * middles[index, 1]
                    wx, wy = x + (c * across - s * along), y + (s * across + c * along)
                    near = bands_near(grid, levels.shell_cells[shell], wx, wy)
                    upcoming = shell + 1
                    if near == 0:
                        clear = (distance_at(grid, wx, wy) + middle) / widening
                        upcoming = max(upcoming, shell_of(table, clear))
                    else:  # the level covers a circle that is several times as large as the cell
                        dx, dy = abs(wx - x) / middle, abs(wy - y) / middle
                        near &= bands_in(grid, wx, wy, depth * dx + width * dy, depth * dy + width * dx)
                    if near != 0:
                        cell = shell * len(middles) + index
                        _visit(table, grid, cell, near, inner, outer, reached, pose, noise, best)
                    if upcoming < shells:
                        following[index] = first[upcoming]
                        first[upcoming] = index
                index = after


@compiled(inline="always")
def shell_of(table: ShellTable, radius: float) -> int:
    """Return the first shell, or an earlier one, that is not entirely within a radius [m]."""
    return int(table.shell_at[min(int(radius / SHELL_STEP_M), len(table.shell_at) - 1)])


@compiled(inline="always")
def half_sides(inner: float, outer: float, half_width: float) -> tuple[float, float]:
    """Return half the depth and half the width [m] of a rectangle that contains a cell of a shell.

    Its center is that of the cell, at the mean of the radii.

    Args:
        inner, outer: radii of the shell [m].
        half_width: of the bin [rad].
    """
    nearest = inner * math.cos(half_width)  # ahead, of the corners
    return (inner + outer) / 2 - nearest + SLACK_M, outer * half_width + SLACK_M


@compiled(inline="always")
def angle_of(error: float, radius: float, offset: float) -> float:
    """Return how far [rad] the azimuth of a point of a ray changes at most if the point moves along the ray.

    If it moves by e between the radii r and q, on a line at a distance d from the center, the sine of the
    change is d e / (r q). The line of a ray is no farther from the center than its origin, or the point.

    Args:
        error: largest distance that the point moves [m].
        radius: smallest distance of the point from the center [m].
        offset: largest distance of an origin from the center [m].
    """
    if error >= radius:
        return math.pi
    return math.asin(error / radius * min(1.0, offset / (radius - error)))


@compiled(inline="always")
def farthest_of(best: Floats, reached: tuple[int, int]) -> float:
    """Return the farthest of the nearest returns [m] from the first to the last sector, modulo sectors."""
    farthest = 0.0
    for sector in range(reached[0], reached[1] + 1):
        farthest = max(farthest, best[sector % len(best)])
    return farthest


@compiled_bare
def _search_core(
    table: ShellTable,
    grid: HeightGrid,
    level: int,
    pose: Pose,
    noise: ReturnNoise | None,
    traced: Bools,
    best: Floats,
) -> None:
    """Trace the rays of the core cells with obstacles nearby, from their origins through the core."""
    x, y, c, s = pose
    shell_cells = len(table.bins) * (len(table.radii) - 1)
    most = largest_error(noise)
    traced[:] = False
    for index in range(len(table.core)):
        ahead, lateral = table.core[index, 0], table.core[index, 1]
        distance = math.sqrt(ahead * ahead + lateral * lateral) - CORE_REACH_M
        margin = 0.0 if noise is None else angle_of(most, distance, table.radii[0])
        low, high = table.core_edges[index]
        reached = sectors_between(low - margin, high + margin, len(best))
        if distance - most > farthest_of(best, reached):
            continue
        near = bands_near(grid, level, x + (c * ahead - s * lateral), y + (s * ahead + c * lateral))
        if near == 0:
            continue
        cell = shell_cells + index
        for slot in range(table.starts[cell], table.starts[cell + 1]):
            run = table.runs[slot]
            if near >> run.low == 0:  # this run and all later ones pass above everything
                break
            if bits(run.low, run.high) & near == 0:
                continue
            farthest = min(farthest_of(best, (0, len(best) - 1)), table.radii[0])
            share = 1.0 if noise is None else share_above(noise, distance - farthest_of(best, reached))
            origin = table.origins[table.sensor[run.first]]
            for number in range(run.first, run.first + run.length):
                if traced[number]:
                    continue
                error = error_above(noise, number, share)
                if error == MISS:
                    continue
                traced[number] = True
                ray = table.rays[number]
                leaves = exit_parameter(origin, ray, farthest)
                if not leaves >= 0.0:  # a ray that starts outside `farthest` and does not enter it
                    continue
                end = min(leaves - min(error, 0.0) + 1e-7, ray[3])
                z, z_end = origin[2], origin[2] + end * ray[2]
                bands = bits(band_at(min(z, z_end)), band_at(max(z, z_end)))
                t = first_hit(grid, in_world(origin, ray, pose), 0.0, end, bands)
                if t <= end:
                    rho, sector = polar(origin, ray, max(t + error, 0.0), len(best))
                    best[sector] = min(best[sector], rho)


# Inlined: a call would copy the fields of all tables, which takes longer than most visits.
@compiled(_nrt=False, forceinline=True)
def _visit(
    table: ShellTable,
    grid: HeightGrid,
    cell: int,
    near: int,
    inner: float,
    outer: float,
    reached: tuple[int, int],
    pose: Pose,
    noise: ReturnNoise | None,
    best: Floats,
) -> None:
    """Trace the rays of a cell in the bands `near` between two radii, and update the nearest returns.

    Their returns are in the sectors `reached`, from the first to the last.
    """
    runs, rays, core = table.runs, table.rays, table.radii[0]
    for slot in range(table.starts[cell], table.starts[cell + 1]):
        run = runs[slot]
        if near >> run.low == 0:  # this run and all later ones pass above everything
            break
        bands = bits(run.low, run.high)
        if bands & near == 0:
            continue
        origin = table.origins[table.sensor[run.first]]
        farthest = farthest_of(best, reached)
        if farthest + largest_error(noise) <= inner:
            return
        bounded = farthest < outer
        share = 1.0 if noise is None else share_above(noise, inner - farthest)
        for index in range(run.first, run.first + run.length):
            error = error_above(noise, index, share) if bounded else 0.0
            within = min(outer, farthest - min(error, 0.0))
            if error == MISS or within <= inner:
                continue
            ray = rays[index]
            begin = exit_parameter(origin, ray, inner) - 1e-7
            end = min(exit_parameter(origin, ray, within) + 1e-7, ray[3])
            if begin > end:
                continue
            t = first_hit(grid, in_world(origin, ray, pose), begin, end, bands)
            if t > end:
                continue
            if not bounded:  # not drawn before, because it could not have shortened the traversal
                error = error_above(noise, index, 1.0)
                if error == MISS:
                    continue
            rho, sector = polar(origin, ray, max(t + error, 0.0), len(best))
            if rho >= best[sector]:
                continue
            clear = _clear_up_to(origin, ray, core, t, largest_error(noise), best)
            if clear < inner:  # something else may be hit first
                t = _trace(grid, origin, ray, clear, t, pose)
                rho, sector = polar(origin, ray, max(t + error, 0.0), len(best))
            best[sector] = min(best[sector], rho)


@compiled_bare
def _trace(grid: HeightGrid, origin: Floats, ray: Floats, clear: float, t: float, pose: Pose) -> float:
    """Return the first hit of a ray between a radius [m] and its parameter t."""
    begin = exit_parameter(origin, ray, clear) - 1e-7 if clear > 0.0 else 0.0
    return min(t, first_hit(grid, in_world(origin, ray, pose), begin, t, -1))


@compiled_bare
def _clear_up_to(origin: Floats, ray: Floats, core: float, t: float, error: float, best: Floats) -> float:
    """Return the radius up to which a ray is known to hit nothing before its parameter t [m].

    In the previous shells it was traversed through each sector up to the nearest return of that sector, and a
    hit would have become such a return, moved by at most `error`. In the core it may pass through any sector.
    """
    if nearest_of(best) - error <= core:
        return 0.0
    first, last = sectors_passed(origin, ray, core, t, error, len(best))
    clear = MISS
    for sector in range(first, last + 1):
        clear = min(clear, best[sector % len(best)])
    return clear - error


@compiled(inline="always")
def nearest_of(best: Floats) -> float:
    """Return the nearest return of all sectors [m]."""
    nearest = MISS
    for sector in range(len(best)):
        nearest = min(nearest, best[sector])
    return nearest


@compiled(inline="always")
def sectors_passed(
    origin: Floats, ray: Floats, core: float, t: float, error: float, sectors: int
) -> tuple[int, int]:
    """Return the first and last sector, modulo `sectors`, that a ray passes from the core to parameter t.

    Both ends are extended by `error` [m].
    """
    begin, end = exit_parameter(origin, ray, core) - error, t + error
    theta = math.atan2(origin[1] + begin * ray[1], origin[0] + begin * ray[0])
    low, high = turn(theta, math.atan2(origin[1] + end * ray[1], origin[0] + end * ray[0]))
    return sectors_between(low, high, sectors)


@compiled(inline="always")
def in_world(origin: Floats, ray: Floats, pose: Pose) -> Line:
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
def polar(origin: Floats, ray: Floats, t: float, sectors: int) -> tuple[float, int]:
    """Return the radius [m] and the sector of a point of a ray."""
    px, py = origin[0] + t * ray[0], origin[1] + t * ray[1]
    return math.sqrt(px * px + py * py), sector_at(math.atan2(py, px), sectors)
