"""The LiDAR scan on the GPU.

It is the scan of `dockctl.sim.lidar.scan` in another order, with the same tables and functions. Its ranges
are equal to the last bit; with noise, whose logarithms and cosines are rounded differently, nearly all are.
One warp of 32 threads scans one sector from one pose: the threads look up the bins of a shell together,
collect the rays that may be the nearest return, and trace 32 of them at a time. Warps do not wait for each
other. A ray that may have hit something in a sector of another warp is therefore traced again from its
origin, and every return is recorded atomically in the sector where it is.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dockctl.geometry import Floats
from dockctl.scenarios.extensions import RangeNoise
from dockctl.sim.gpu.azimuth import edges_of, sector_of
from dockctl.sim.gpu.kernels import ALL_THREADS, WARP, blocks, cuda, kernel, to_gpu
from dockctl.sim.lidar.height_grid import (
    HeightGrid,
    band_at,
    bands_in,
    bands_near,
    bits,
    distance_at,
    first_hit,
    floor,
)
from dockctl.sim.lidar.raycast import MISS
from dockctl.sim.lidar.return_noise import ReturnNoise, error_above, largest_error, share_above
from dockctl.sim.lidar.scan import (
    angle_of,
    farthest_of,
    half_sides,
    in_world,
    nearest_of,
    sectors_passed,
    shell_of,
)
from dockctl.sim.lidar.shell_table import BINS_PER_SECTOR, Levels, ShellTable, exit_parameter

CORE_THREADS, CORE_BLOCKS = 256, 16
"""Threads of a block, and blocks for each pose, that trace the rays through the core."""
WARPS = 4
"""Warps of a block that scan the shells."""
QUEUE = 2 * WARP
"""Rays that a warp can collect."""
assert BINS_PER_SECTOR == WARP


class GpuSensor:
    """The spinning LiDARs in one harbor, with their tables in the memory of the GPU.

    Args:
        tables: of `dockctl.sim.lidar.spinning_sensor.SpinningSensor`.
        range_m: range of a sector without a return [m].
        sectors: number of sectors.
    """

    def __init__(self, tables: tuple[ShellTable, HeightGrid, Levels], range_m: float, sectors: int) -> None:
        shells, grid, levels = map(to_gpu, tables)
        self._tables = ShellTable(*shells), HeightGrid(*grid), Levels(*levels)
        self._range_m, self._sectors = range_m, sectors
        self._edges = to_gpu([edges_of(sectors)])[0]

    def sector_ranges(self, eta: Floats) -> Floats:
        """Return the range of the nearest return in each sector, (n, 3) to (n, sectors) [m]."""
        return self._scan(eta, None)

    def noisy_sector_ranges(self, eta: Floats, noise: RangeNoise) -> Floats:
        """Return the range of the nearest noisy return in each sector, (n, 3) to (n, sectors) [m]."""
        return self._scan(eta, (noise.seeds, noise.sigma_m, noise.lost_returns))

    def _scan(self, eta: Floats, noise: tuple[Any, ...] | None) -> Floats:
        ranges = np.full((len(eta), self._sectors), self._range_m)
        if len(eta) == 0:
            return ranges
        x, y, heading = eta.T
        # As in the scan on the CPU: cosines of another library could differ in the last bit.
        cosine, sine = ([*map(function, heading)] for function in (math.cos, math.sin))
        noise = None if noise is None else tuple(to_gpu(noise))
        on_gpu = *self._tables, self._edges, noise, *to_gpu([np.column_stack([x, y, cosine, sine]), ranges])
        _scan_core[(len(eta), CORE_BLOCKS), CORE_THREADS](*on_gpu)
        _scan_shells[blocks(ranges.size, WARPS), WARPS * WARP](*on_gpu)
        on_gpu[-1].copy_to_host(ranges)
        return ranges


@kernel
def _scan_core(table: Any, grid: Any, levels: Any, edges: Any, noises: Any, poses: Any, out: Any) -> None:
    """Trace the rays from one pose through the core, if anything is near it."""
    row = cuda.blockIdx.x
    pose = (poses[row, 0], poses[row, 1], poses[row, 2], poses[row, 3])
    present = bands_near(grid, levels.whole_core, pose[0], pose[1])
    if present == 0:
        return
    noise = None if noises is None else ReturnNoise(noises[0][row], noises[1][row], noises[2][row])
    first = cuda.blockIdx.y * CORE_THREADS + cuda.threadIdx.x
    for number in range(first, len(table.rays), CORE_BLOCKS * CORE_THREADS):
        ray, origin = table.rays[number], table.origins[table.sensor[number]]
        end = min(exit_parameter(origin, ray, table.radii[0]) + 1e-7, ray[3])
        z, z_end = origin[2], origin[2] + end * ray[2]
        bands = bits(band_at(min(z, z_end)), band_at(max(z, z_end)))
        if bands & present == 0:
            continue
        error = error_above(noise, number, 1.0)
        if error == MISS:
            continue
        t = first_hit(grid, in_world(origin, ray, pose), 0.0, end, bands)
        if t <= end:
            rho, sector = _polar(origin, ray, max(t + error, 0.0), edges)
            cuda.atomic.min(out, (row, sector), rho)


@kernel
def _scan_shells(table: Any, grid: Any, levels: Any, edges: Any, noises: Any, poses: Any, out: Any) -> None:
    """Trace the rays of one sector from one pose, from shell to shell outward."""
    sectors, shells, bins = out.shape[1], len(table.radii) - 1, len(table.bins)
    warp, lane = cuda.threadIdx.x // WARP, cuda.threadIdx.x % WARP
    row, own = (cuda.blockIdx.x * WARPS + warp) // sectors, (cuda.blockIdx.x * WARPS + warp) % sectors
    slots = cuda.shared.array((WARPS, QUEUE), np.uint32)
    rays = cuda.shared.array((WARPS, QUEUE), np.uint32)
    bins_of = cuda.shared.array((WARPS, QUEUE), np.uint32)
    if row >= len(poses):
        return
    queued, lower_lanes = 0, (1 << lane) - 1
    best = out[row]
    x, y, c, s = poses[row, 0], poses[row, 1], poses[row, 2], poses[row, 3]
    pose = (x, y, c, s)
    noise = None if noises is None else ReturnNoise(noises[0][row], noises[1][row], noises[2][row])
    most = largest_error(noise)
    index = own * WARP + lane
    ahead, lateral = table.bins[index, 0], table.bins[index, 1]
    east, north = c * ahead - s * lateral, s * ahead + c * lateral
    half_width = math.pi / bins
    shell = shell_of(table, distance_at(grid, x, y))
    upcoming = shell
    while shell < shells:
        inner, outer = table.radii[shell], table.radii[shell + 1]
        turned = angle_of(most, inner, table.radii[0])
        margin = 0 if noise is None else 1 + floor(turned * bins / (2 * math.pi))
        waiting = farthest_of(best, _sectors_near(index, margin)) + most > inner
        # By vote, because the threads may see different returns of other warps.
        if not cuda.any_sync(ALL_THREADS, waiting):
            return
        near = 0
        if not waiting:
            upcoming = shells
        if upcoming <= shell:
            middle = (inner + outer) / 2
            wx, wy = x + middle * east, y + middle * north
            near = bands_near(grid, levels.shell_cells[shell], wx, wy)
            upcoming = shell + 1
            if near == 0:
                clear = (distance_at(grid, wx, wy) + middle) / (1.0 + half_width)
                upcoming = max(upcoming, shell_of(table, clear))
            else:
                depth, width = half_sides(inner, outer, half_width)
                dx, dy = abs(east), abs(north)
                near &= bands_in(grid, wx, wy, depth * dx + width * dy, depth * dy + width * dx)
        cells = cuda.ballot_sync(ALL_THREADS, near != 0)
        while cells != 0:
            other = cuda.ffs(cells) - 1
            cells &= cells - 1
            present = cuda.shfl_sync(ALL_THREADS, near, other)
            cell = shell * bins + own * WARP + other
            reached = _sectors_near(own * WARP + other, margin)
            last = np.int64(table.starts[cell + 1])
            for first in range(np.int64(table.starts[cell]), last, WARP):
                slot = min(first + lane, last - 1)
                run = table.runs[slot]
                low: Any = np.int64(run.low)
                high: Any = np.int64(run.high)
                if not cuda.any_sync(ALL_THREADS, present >> low != 0):
                    break  # the lowest runs are first
                used = first + lane < last and bits(low, high) & present != 0
                length = np.int64(run.length) if used else 0
                step = 0
                while cuda.any_sync(ALL_THREADS, step < length):
                    number: Any = np.int64(run.first) + step
                    wanted = step < length
                    if noise is not None and wanted:
                        share = share_above(noise, inner - farthest_of(best, reached))
                        wanted = error_above(noise, number, share) != MISS
                    chosen = cuda.ballot_sync(ALL_THREADS, wanted)
                    if wanted:
                        place = queued + cuda.popc(chosen & lower_lanes)
                        slots[warp, place], rays[warp, place] = slot, number
                        bins_of[warp, place] = own * WARP + other
                    queued += cuda.popc(chosen)
                    cuda.syncwarp()
                    if queued >= WARP:
                        queued -= WARP
                        place = queued + lane
                        task = slots[warp, place], rays[warp, place], bins_of[warp, place]
                        _trace(table, grid, edges, pose, noise, task, (inner, outer), margin, out, row)
                        cuda.syncwarp()
                    step += 1
        if lane < queued:
            task = slots[warp, lane], rays[warp, lane], bins_of[warp, lane]
            _trace(table, grid, edges, pose, noise, task, (inner, outer), margin, out, row)
        queued = 0
        cuda.syncwarp()
        following = upcoming
        for distance in (16, 8, 4, 2, 1):
            following = min(following, cuda.shfl_xor_sync(ALL_THREADS, following, distance))
        shell = max(shell + 1, following)


@cuda.jit(device=True)
def _trace(
    table: Any,
    grid: Any,
    edges: Any,
    pose: Any,
    noise: Any,
    task: tuple[int, int, int],
    shell: tuple[float, float],
    margin: int,
    out: Any,
    row: int,
) -> None:
    """Trace one ray through a shell, and record its return if it is the nearest of its sector.

    Args:
        task: index of the run, number of the ray, and index of the bin.
        shell: inner and outer radius [m].
        margin: number of bins by which its return can be away from the bin.
    """
    (slot, number, index), (inner, outer) = task, shell
    best, sectors, core = out[row], out.shape[1], table.radii[0]
    own, reached = index // WARP, _sectors_near(index, margin)
    error = error_above(noise, number, 1.0)
    within = min(outer, farthest_of(best, reached) - min(error, 0.0))
    if error == MISS or within <= inner:
        return
    ray, origin, run = table.rays[number], table.origins[table.sensor[number]], table.runs[slot]
    begin = exit_parameter(origin, ray, inner) - 1e-7
    end = min(exit_parameter(origin, ray, within) + 1e-7, ray[3])
    if begin > end:
        return
    line = in_world(origin, ray, pose)
    t = first_hit(grid, line, begin, end, bits(int(run.low), int(run.high)))
    if t > end:
        return
    rho, sector = _polar(origin, ray, max(t + error, 0.0), edges)
    if rho >= best[sector]:
        return
    most = largest_error(noise)
    low, high = sectors_passed(origin, ray, core, t, most, sectors)
    # Outside the core and in its own sector, this warp has traced the ray up to here.
    if low != high or low % sectors != own or nearest_of(best) - most <= core:
        t = min(t, first_hit(grid, line, 0.0, t, -1))
        rho, sector = _polar(origin, ray, max(t + error, 0.0), edges)
    cuda.atomic.min(out, (row, sector), rho)


@cuda.jit(device=True)
def _sectors_near(index: int, margin: int) -> tuple[int, int]:
    """Return the first and last sector, modulo sectors, with bins up to `margin` away from a bin."""
    signed: Any = np.int64(index)
    return (signed - margin) // WARP, (signed + margin) // WARP


@cuda.jit(device=True)
def _polar(origin: Any, ray: Any, t: float, edges: Any) -> tuple[float, int]:
    """Return what `dockctl.sim.lidar.scan.polar` returns on the CPU."""
    x, y = origin[0] + t * ray[0], origin[1] + t * ray[1]
    return math.sqrt(x * x + y * y), sector_of(x, y, edges)
