"""The fast LiDAR scan with noisy returns: exactly what a full scan with the same noise would give.

The noise of a ray depends only on the seed of the scan and the number of the ray, so it is the same whether
all rays are traced or few. It moves a return along its ray by at most `MOST_SIGMAS` standard deviations, m.
A shell at the inner radius r can therefore only change a sector whose nearest return is beyond r - m, and
sectors within the angle asin(m / r) of the return. Otherwise the search is that of `scan`, but for the
shortcut that infers which returns are first: with noise and lost returns it does not hold, so a ray that may
change a sector is traced again from its origin.
"""

from __future__ import annotations

import math

import numpy as np

from dockctl.compute import compiled
from dockctl.geometry import Floats
from dockctl.noise import Seeds, normal, uniform
from dockctl.sim.lidar.height_grid import HeightGrid, bands_near, bits, distance_at, first_hit
from dockctl.sim.lidar.raycast import compiled_bare
from dockctl.sim.lidar.scan import Levels, Pose, ShellTable, _exit_parameter, _in_world, _polar

MOST_SIGMAS = 5.0
"""Larger errors, 6e-7 of all, are cut off here."""


@compiled_bare
def range_error(seed: int, ray: int) -> float:
    """Return the error of a ray's range in standard deviations."""
    return min(max(normal(seed, ray), -MOST_SIGMAS), MOST_SIGMAS)


@compiled_bare
def is_lost(seed: int, ray: int, share: float) -> bool:
    """Return whether the return of a ray is lost."""
    return share > 0.0 and uniform(np.uint64(seed) + np.uint64(1), ray) < share


@compiled_bare
def noisy_sector_ranges(
    table: ShellTable,
    grid: HeightGrid,
    levels: Levels,
    range_m: float,
    poses: Floats,
    seeds: Seeds,
    sigma_m: Floats,
    lost: Floats,
    skip_below: Floats,
    out: Floats,
) -> None:
    """Write the nearest noisy return in each sector [m] from the poses (n, 3) to `out` (n, sectors).

    Args:
        seeds, sigma_m, lost: (n,) seed of the scan, standard deviation [m], share of lost returns.
        skip_below: (bins,) work array.
    """
    radii, middles = table.radii, table.bins
    sectors, shells, all_bins = out.shape[1], len(radii) - 1, len(middles)
    bins = all_bins // sectors
    widening = 1.0 + math.pi / all_bins
    for row in range(len(poses)):
        x, y = poses[row, 0], poses[row, 1]
        c, s = math.cos(poses[row, 2]), math.sin(poses[row, 2])
        pose, best = (x, y, c, s), out[row]
        noise = (seeds[row], sigma_m[row], lost[row])
        farthest = MOST_SIGMAS * sigma_m[row] + 1e-9
        best[:] = range_m
        skip_below[:] = 0.0
        if bands_near(grid, levels.whole_core, x, y) != 0:
            _search_core(table, grid, levels.core_cell, pose, noise, best)
        for shell in range(shells):
            inner, outer = radii[shell], radii[shell + 1]
            middle = (inner + outer) / 2
            turn = math.asin(min(1.0, farthest / inner))
            margin = min(math.ceil(turn / (2.0 * math.pi / all_bins)), all_bins // 2)
            searching = False
            for index in range(all_bins):
                first, last = (index - margin + all_bins) // bins, (index + margin + all_bins) // bins
                needed = False
                for sector in range(first, last + 1):
                    needed |= best[sector % sectors] > inner - farthest
                if not needed:
                    continue
                searching = True
                if skip_below[index] >= outer:
                    continue
                across, along = middle * middles[index, 0], middle * middles[index, 1]
                wx, wy = x + (c * across - s * along), y + (s * across + c * along)
                near = bands_near(grid, levels.shell_cells[shell], wx, wy)
                if near == 0:
                    skip_below[index] = (distance_at(grid, wx, wy) + middle) / widening
                else:
                    _visit(table, grid, shell * all_bins + index, near, inner, outer, pose, noise, best)
            if not searching:
                break


@compiled_bare
def _search_core(
    table: ShellTable,
    grid: HeightGrid,
    level: int,
    pose: Pose,
    noise: tuple[int, float, float],
    best: Floats,
) -> None:
    x, y, c, s = pose
    shell_cells = len(table.bins) * (len(table.radii) - 1)
    for index in range(len(table.core)):
        ahead, lateral = table.core[index, 0], table.core[index, 1]
        near = bands_near(grid, level, x + (c * ahead - s * lateral), y + (s * ahead + c * lateral))
        if near != 0:
            _visit(table, grid, shell_cells + index, near, 0.0, table.radii[0], pose, noise, best)


@compiled_bare
def _visit(
    table: ShellTable,
    grid: HeightGrid,
    cell: int,
    near: int,
    inner: float,
    outer: float,
    pose: Pose,
    noise: tuple[int, float, float],
    best: Floats,
) -> None:
    """Traverse the rays of a cell in the bands `near` between two radii, and update the nearest returns."""
    runs, rays = table.runs, table.rays
    seed, sigma_m, lost = noise
    for slot in range(table.starts[cell], table.starts[cell + 1]):
        run = runs[slot]
        if near >> run.low == 0:  # this run and the following ones are above everything
            break
        bands = bits(run.low, run.high)
        if bands & near == 0:
            continue
        if inner == 0.0:  # through the whole core, beyond this cell
            bands = -1
        origin = table.origins[table.sensor[run.first]]
        for index in range(run.first, run.first + run.length):
            if is_lost(seed, index, lost):
                continue
            ray = rays[index]
            begin = _exit_parameter(origin, ray, inner) - 1e-7 if inner > 0.0 else 0.0
            end = min(_exit_parameter(origin, ray, outer) + 1e-7, ray[3])
            if begin > end:
                continue
            line = _in_world(origin, ray, pose)
            t = first_hit(grid, line, begin, end, bands)
            if t > end:
                continue
            error = sigma_m * range_error(seed, index)
            rho, sector = _polar(origin, ray, max(0.0, t + error), len(best))
            if rho >= best[sector]:
                continue
            if inner > 0.0:  # something else may be hit first
                t = min(t, first_hit(grid, line, 0.0, t, -1))
                rho, sector = _polar(origin, ray, max(0.0, t + error), len(best))
            best[sector] = min(best[sector], rho)


@compiled()
def noisy_hits(hits: Floats, seed: int, sigma_m: float, lost: float) -> Floats:
    """Return the ray parameters (k,) of a full scan with noise; infinite where there is no return."""
    noisy = np.empty_like(hits)
    for ray in range(len(hits)):
        gone = not math.isfinite(hits[ray]) or is_lost(seed, ray, lost)
        noisy[ray] = math.inf if gone else max(0.0, hits[ray] + sigma_m * range_error(seed, ray))
    return noisy
