"""A grid over the harbor's plan: at which heights anything stands in each cell, and which triangles do.

The grid serves the fast LiDAR scan. It answers three questions, all on the safe side: at which heights is
anything within a radius of a point, how far is the nearest thing, and which triangles can a ray meet in a
cell. Heights are told in bands, one bit each: a ray may pass between a deck and a boom, or under a stay.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dockctl.sim.raycast import MISS, corner_and_edges, hit_triangle, njit_bare

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Bands = NDArray[np.int64]
Line = tuple[float, float, float, float, float, float]

FINEST_CELL_M = 0.1
MOST_CELLS = 4_000_000
SMALLEST_RADIUS_M = 0.1
RADIUS_GROWTH = 1.2
SLACK_M = 1e-5  # outweighs every rounding, in float32 too


@njit(cache=True, nogil=True, inline="always")
def bands_between(low: float, high: float) -> int:
    """Return the bits of the bands of height between two heights [m].

    40 bands of 0.1 m, 21 of 0.5 m, and one for all above; everything under water counts as the lowest.
    """
    first, last = _band(low), _band(high)
    return (2 << last) - (1 << first)


@njit(cache=True, nogil=True, inline="always")
def _band(z: float) -> int:
    if z < 4.0:
        return int(max(z, 0.0) * 10.0)
    return min(40 + int((z - 4.0) * 2.0), 61)


class HeightGrid(NamedTuple):
    """Bands of height on a grid of square cells; rows run along y.

    Attributes:
        frame: (3,) x and y of the lower corner, and the cell's side [m].
        bands: (ny, nx) bits of the bands in which anything stands in each cell.
        starts, members: triangles of cell ``iy * nx + ix`` are ``members[starts[cell]:starts[cell + 1]]``.
        triangles: (m, 9) as `hit_triangle` takes them.
        distances: (ny, nx) from anywhere in a cell to the nearest cell that is not empty, at least [m].
        radii: (levels,) [m].
        level_shape: (levels, 4) offset into `dilated`, nx, ny and stride in cells of each level.
        dilated: levels end to end: the bands within the level's radius of anywhere in a cell.
    """

    frame: Floats
    bands: Bands
    starts: Ints
    members: Ints
    triangles: Floats
    distances: Singles
    radii: Floats
    level_shape: Ints
    dilated: Bands

    @classmethod
    def over(cls, triangles: Floats, largest_radius_m: float) -> HeightGrid:
        """Build the grid over (m, 3, 3) triangles [m], with levels up to at least `largest_radius_m`."""
        above = triangles[triangles[:, :, 2].max(axis=1, initial=-math.inf) >= 0.0]
        levels = max(1, math.ceil(math.log(largest_radius_m / SMALLEST_RADIUS_M, RADIUS_GROWTH)) + 1)
        radii: Floats = SMALLEST_RADIUS_M * np.float64(RADIUS_GROWTH) ** np.arange(levels)
        margin = radii[-1] + 1.0
        corners = above.reshape(-1, 3)[:, :2] if len(above) else np.zeros((1, 2))
        low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
        cell = max(FINEST_CELL_M, math.sqrt(float(np.prod(high - low)) / MOST_CELLS))
        nx, ny = (math.ceil(side / cell) for side in high - low)
        frame = np.array([low[0], low[1], cell])
        counts = np.zeros(nx * ny + 1, np.int32)
        bands = np.zeros((ny, nx), np.int64)
        _lay(above, frame, bands, counts, np.empty(0, np.int32))
        starts = np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.int32)
        members = np.empty(starts[-1], np.int32)
        _lay(above, frame, bands, starts[:-1].copy(), members)
        shapes, dilated = _dilate_levels(bands, radii, cell)
        return cls(
            frame=frame,
            bands=bands,
            starts=starts,
            members=members,
            triangles=corner_and_edges(above),
            distances=_distances(bands, cell),
            radii=radii,
            level_shape=shapes,
            dilated=dilated,
        )

    def levels_for(self, radii_m: Floats) -> Ints:
        """Return the first level whose radius is at least each of the (k,) radii [m]."""
        return np.searchsorted(self.radii, radii_m).astype(np.int32)


@njit(cache=True)
def _lay(triangles: Floats, frame: Floats, bands: Bands, places: Ints, members: Ints) -> None:
    """Enter each triangle in the cells that its plan touches, with the heights at which it passes there.

    Triangles are only counted in `places` where `members` is empty, otherwise filled in from there on.
    """
    ny, nx = bands.shape
    x0, y0, cell = frame
    polygon, scratch = np.empty((8, 3)), np.empty((8, 3))
    for index in range(len(triangles)):
        t = triangles[index]
        low_x, high_x = t[:, 0].min() - SLACK_M, t[:, 0].max() + SLACK_M
        low_y, high_y = t[:, 1].min() - SLACK_M, t[:, 1].max() + SLACK_M
        for iy in range(max(0, int((low_y - y0) / cell)), min(ny - 1, int((high_y - y0) / cell)) + 1):
            for ix in range(max(0, int((low_x - x0) / cell)), min(nx - 1, int((high_x - x0) / cell)) + 1):
                polygon[:3] = t
                corners = 3
                left, lower = x0 + ix * cell, y0 + iy * cell
                corners = _cut(polygon, scratch, corners, 0, 1.0, left - SLACK_M)
                corners = _cut(scratch, polygon, corners, 0, -1.0, -(left + cell + SLACK_M))
                corners = _cut(polygon, scratch, corners, 1, 1.0, lower - SLACK_M)
                corners = _cut(scratch, polygon, corners, 1, -1.0, -(lower + cell + SLACK_M))
                if corners == 0:
                    continue
                place = iy * nx + ix
                if len(members) > 0:
                    members[places[place]] = index
                places[place] += 1
                z = polygon[:corners, 2]
                if z.max() + SLACK_M >= 0.0:
                    bands[iy, ix] |= bands_between(z.min() - SLACK_M, z.max() + SLACK_M)


@njit(cache=True)
def _cut(polygon: Floats, out: Floats, corners: int, axis: int, sign: float, bound: float) -> int:
    """Cut a convex polygon by ``sign * p[axis] >= bound`` into `out`, and return the corners left.

    Sutherland and Hodgman, "Reentrant polygon clipping", 1974.
    """
    kept = 0
    for i in range(corners):
        j = (i + 1) % corners
        a, b = sign * polygon[i, axis] - bound, sign * polygon[j, axis] - bound
        if a >= 0.0:
            out[kept] = polygon[i]
            kept += 1
        if (a >= 0.0) != (b >= 0.0):
            out[kept] = polygon[i] + (polygon[j] - polygon[i]) * (a / (a - b))
            kept += 1
    return kept


def _dilate_levels(bands: Bands, radii: Floats, cell: float) -> tuple[Ints, Bands]:
    """Return `level_shape` and `dilated` for the radii; a wide radius needs no fine cells."""
    shapes, parts, offset = [], [], 0
    for radius in radii:
        stride = max(1, 2 ** int(math.log2(max(1.0, radius / cell / 3))))
        level = _window_union(_block_union(bands, stride), math.ceil(radius / (cell * stride)))
        shapes.append((offset, level.shape[1], level.shape[0], stride))
        parts.append(level.ravel())
        offset += level.size
    return np.array(shapes, np.int32), np.concatenate(parts)


def _block_union(bands: Bands, stride: int) -> Bands:
    """Return the bands of each block of `stride` by `stride` cells."""
    ny, nx = bands.shape
    padded = np.pad(bands, ((0, -ny % stride), (0, -nx % stride)))
    blocks = padded.reshape(padded.shape[0] // stride, stride, padded.shape[1] // stride, stride)
    return np.asarray(np.bitwise_or.reduce(np.bitwise_or.reduce(blocks, axis=3), axis=1), np.int64)


def _window_union(bands: Bands, reach: int) -> Bands:
    """Return the bands in the square window of `reach` cells to every side."""
    for axis in (0, 1):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (reach, reach)
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(bands, pad), 2 * reach + 1, axis)
        bands = np.bitwise_or.reduce(windows, axis=-1)
    return np.ascontiguousarray(bands)


@njit(cache=True)
def _distances(bands: Bands, cell: float) -> Singles:
    """Return a lower bound of the distance to the nearest cell that is not empty.

    Exact squared distances between cell centres by lower envelopes of parabolas (Felzenszwalb and
    Huttenlocher, "Distance transforms of sampled functions", 2012), less a cell's diagonal.
    """
    ny, nx = bands.shape
    far = 1e12
    squared = np.where(bands > 0, 0.0, far)
    longest = max(nx, ny)
    vertex = np.empty(longest, np.int64)
    border = np.empty(longest + 1)
    for axis in range(2):
        lines, length = (nx, ny) if axis == 0 else (ny, nx)
        for line in range(lines):
            f = squared[:, line].copy() if axis == 0 else squared[line].copy()
            last = 0
            vertex[0] = 0
            border[0], border[1] = -far, far
            for q in range(1, length):
                while True:
                    p = vertex[last]
                    meet = ((f[q] + q * q) - (f[p] + p * p)) / (2.0 * (q - p))
                    if meet > border[last] or last == 0:
                        break
                    last -= 1
                if meet > border[last]:
                    last += 1
                vertex[last] = q
                border[last] = meet if last > 0 else -far
                border[last + 1] = far
            nearest = 0
            for q in range(length):
                while border[nearest + 1] < q:
                    nearest += 1
                value = (q - vertex[nearest]) ** 2 + f[vertex[nearest]]
                if axis == 0:
                    squared[q, line] = value
                else:
                    squared[line, q] = value
    return np.maximum(np.sqrt(squared) * cell - math.sqrt(2.0) * cell - SLACK_M, 0.0).astype(np.float32)


@njit(cache=True, nogil=True, inline="always")
def bands_near(grid: HeightGrid, level: int, x: float, y: float) -> int:
    """Return the bands of height in which anything stands within the level's radius of (x, y)."""
    offset, nx, ny, stride = grid.level_shape[level]
    ix = math.floor((x - grid.frame[0]) / (grid.frame[2] * stride))
    iy = math.floor((y - grid.frame[1]) / (grid.frame[2] * stride))
    if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
        return 0  # the grid's margin is wider than every radius
    return int(grid.dilated[offset + iy * nx + ix])


@njit(cache=True, nogil=True, inline="always")
def distance_at(grid: HeightGrid, x: float, y: float) -> float:
    """Return a lower bound of the distance from (x, y) to anything [m]."""
    ny, nx = grid.distances.shape
    left, lower, cell = grid.frame
    ix, iy = math.floor((x - left) / cell), math.floor((y - lower) / cell)
    if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
        beyond_x = max(left - x, x - left - nx * cell, 0.0)
        beyond_y = max(lower - y, y - lower - ny * cell, 0.0)
        return math.sqrt(beyond_x * beyond_x + beyond_y * beyond_y)
    return float(grid.distances[iy, ix])


@njit_bare
def first_hit(grid: HeightGrid, line: Line, begin: float, end: float) -> float:
    """Walk a ray between two of its parameters, cell by cell, to its closest hit there or infinity.

    As in Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987; a cell that the ray
    passes above or below all that stands there is skipped. A hit on a triangle of a visited cell also counts
    just past `end`.

    Args:
        grid: the harbor.
        line: x, y, z of the ray's origin [m] and of its direction, in the world frame.
        begin, end: ray parameters.
    """
    ox, oy, oz, dx, dy, dz = line
    bands, starts, members, triangles = grid.bands, grid.starts, grid.members, grid.triangles
    ny, nx = bands.shape
    left, lower, cell = grid.frame
    # Into cell coordinates, and cut to the grid.
    px, py, vx, vy = (ox - left) / cell, (oy - lower) / cell, dx / cell, dy / cell
    if vx != 0.0:
        a, b = -px / vx, (nx - px) / vx
        begin, end = max(begin, min(a, b)), min(end, max(a, b))
    elif px < 0.0 or px >= nx:
        return MISS
    if vy != 0.0:
        a, b = -py / vy, (ny - py) / vy
        begin, end = max(begin, min(a, b)), min(end, max(a, b))
    elif py < 0.0 or py >= ny:
        return MISS
    if begin > end:
        return MISS
    ix = min(max(math.floor(px + begin * vx), 0), nx - 1)
    iy = min(max(math.floor(py + begin * vy), 0), ny - 1)
    step_x, step_y = (1 if vx > 0.0 else -1), (1 if vy > 0.0 else -1)
    next_x = (ix + (vx > 0.0) - px) / vx if vx != 0.0 else MISS
    next_y = (iy + (vy > 0.0) - py) / vy if vy != 0.0 else MISS
    across_x = abs(1.0 / vx) if vx != 0.0 else MISS
    across_y = abs(1.0 / vy) if vy != 0.0 else MISS
    best = MISS
    entry = begin
    while True:
        leave = min(next_x, next_y)
        here, there = oz + dz * entry, oz + dz * min(leave, end)
        if bands[iy, ix] & bands_between(min(here, there), max(here, there)):
            place = iy * nx + ix
            for slot in range(starts[place], starts[place + 1]):
                t = hit_triangle(triangles[members[slot]], ox, oy, oz, dx, dy, dz)
                if t < best:
                    best = t
        if best <= leave or leave >= end:
            return best
        entry = leave
        if next_x < next_y:
            ix += step_x
            next_x += across_x
        else:
            iy += step_y
            next_y += across_y
        if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
            return best
