"""A grid over the plan of the harbor: the heights of obstacles and the triangles in each cell.

The fast LiDAR scan uses it for conservative answers to three questions: at which heights are obstacles within
a radius of a point, how far is the nearest one, and which triangles can a ray hit in a cell. Heights are sets
of bands, one bit each, because a ray may pass between a deck and a boom, or under a stay.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import compiled
from dockctl.errors import DockctlError
from dockctl.geometry import Floats
from dockctl.sim.lidar.raycast import MISS, compiled_bare, corner_and_edges, hit_triangle

Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Bands = NDArray[np.int64]
Members = NDArray[np.void]
Line = tuple[float, float, float, float, float, float]

FINEST_CELL_M = 0.1
MAX_CELLS = 4_000_000
MAX_MEMBERS = 100_000_000
"""Triangles of all cells, at 6 bytes each."""
# Radii of the levels, in cells: these, then 4, 5, 6 times 2, 4, 8 ... on cells as much larger.
FINE_REACHES = (1, 2, 3, 4, 5, 6)
COARSE_REACHES = (4, 5, 6)
DISTANCE_STRIDE = 2
SLACK_M = 1e-5  # greater than any rounding error, also in float32

MEMBER = np.dtype([("triangle", np.int32), ("low", np.uint8), ("high", np.uint8)])


@compiled(inline="always")
def band_at(z: float) -> int:
    """Return the band of a height [m]: 40 of 0.1 m, 21 of 0.5 m, one above; the lowest if negative."""
    if z < 4.0:
        return int(max(z, 0.0) * 10.0)
    return min(40 + int((z - 4.0) * 2.0), 61)


@compiled(inline="always")
def bits(low: int, high: int) -> int:
    """Return the bits of the bands from `low` to `high`."""
    return (2 << high) - (1 << low)


class HeightGrid(NamedTuple):
    """Bands of height on a grid of square cells; rows run along y.

    Few sets of bands occur, so a cell stores an index into `palette`, with an eighth of the memory.

    Attributes:
        frame: (3,) x and y of the lower corner, and the cell size [m].
        radii: (levels,) [m]; the first is 0.
        level_shape: (levels, 4) offset into `levels`, nx, ny and stride in cells of each level.
        levels: for each level and cell, the bands within the radius of the level of any point of the cell;
            indices into `palette`.
        palette: (sets,) sets of bands with obstacles; the first is 0.
        starts, members: triangles of cell ``iy * nx + ix`` are ``members[starts[cell]:starts[cell + 1]]``,
            with their lowest and highest band in the cell.
        triangles: (m, 9) in the form of `hit_triangle`.
        distances: lower bound of the distance from any point of a block of cells to a cell that is not empty
            [m].
    """

    frame: Floats
    radii: Floats
    level_shape: Ints
    levels: NDArray[np.unsignedinteger[Any]]
    palette: Bands
    starts: Ints
    members: Members
    triangles: Floats
    distances: Singles

    @classmethod
    def build(cls, triangles: Floats, largest_radius_m: float) -> HeightGrid:
        """Build the grid over (m, 3, 3) triangles [m], with levels up to at least `largest_radius_m`."""
        above = triangles[triangles[:, :, 2].max(axis=1, initial=-math.inf) >= 0.0]
        corners = above.reshape(-1, 3)[:, :2] if len(above) else np.zeros((1, 2))
        margin = largest_radius_m + 1.0
        low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
        cell = max(FINEST_CELL_M, math.sqrt(float(np.prod(high - low)) / MAX_CELLS))
        nx, ny = (math.ceil(side / cell) for side in high - low)
        touched = (np.ptp(above[:, :, :2], axis=1) // cell + 2).prod(axis=1).sum()
        if touched > MAX_MEMBERS:
            raise DockctlError(
                f"harbor: its triangles overlap in plan view: they cover {touched:,.0f} cells of {cell:.2g} m"
                f" of the LiDAR's grid, at most {MAX_MEMBERS:,}; simplify its meshes",
                code="out_of_range",
            )
        frame = np.array([low[0], low[1], cell])
        counts = np.zeros(nx * ny + 1, np.int32)
        bands = np.zeros((ny, nx), np.int64)
        _rasterize(above, frame, bands, counts, np.empty(0, MEMBER))
        starts = np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.int32)
        members = np.empty(starts[-1], MEMBER)
        _rasterize(above, frame, bands, starts[:-1].copy(), members)
        radii, shapes, levels = _dilate_levels(bands, cell, largest_radius_m)
        palette = np.unique(levels)
        place_type = np.uint16 if len(palette) <= 1 << 16 else np.uint32
        return cls(
            frame=frame,
            radii=radii,
            level_shape=shapes,
            levels=np.searchsorted(palette, levels).astype(place_type),
            palette=palette,
            starts=starts,
            members=members,
            triangles=corner_and_edges(above),
            distances=_distances(_block_union(bands, DISTANCE_STRIDE), cell * DISTANCE_STRIDE),
        )


@compiled()
def _rasterize(triangles: Floats, frame: Floats, bands: Bands, places: Ints, members: Members) -> None:
    """Add each triangle, with its bands, to the cells that it touches in plan view.

    If `members` is empty, triangles are counted in `places`; otherwise they are written from `places` on.
    Triangles under water are skipped: rays end at the water surface.
    """
    ny, nx = bands.shape
    x0, y0, cell = frame
    polygon, scratch = np.empty((8, 3)), np.empty((8, 3))
    for index in range(len(triangles)):
        (low_x, high_x), (low_y, high_y) = _extent(triangles[index], 3, 0), _extent(triangles[index], 3, 1)
        for iy in range(max(0, int((low_y - y0) / cell)), min(ny - 1, int((high_y - y0) / cell)) + 1):
            for ix in range(max(0, int((low_x - x0) / cell)), min(nx - 1, int((high_x - x0) / cell)) + 1):
                for corner in range(3):
                    for axis in range(3):
                        polygon[corner, axis] = triangles[index, corner, axis]
                corners = 3
                left, lower = x0 + ix * cell, y0 + iy * cell
                corners = _cut(polygon, scratch, corners, 0, 1.0, left - SLACK_M)
                corners = _cut(scratch, polygon, corners, 0, -1.0, -(left + cell + SLACK_M))
                corners = _cut(polygon, scratch, corners, 1, 1.0, lower - SLACK_M)
                corners = _cut(scratch, polygon, corners, 1, -1.0, -(lower + cell + SLACK_M))
                low_z, high_z = _extent(polygon, corners, 2)
                if high_z < 0.0:
                    continue
                low, high = band_at(low_z), band_at(high_z)
                place = iy * nx + ix
                if len(members) > 0:
                    member = members[places[place]]
                    member.triangle, member.low, member.high = index, low, high
                places[place] += 1
                bands[iy, ix] |= bits(low, high)


@compiled()
def _extent(points: Floats, count: int, axis: int) -> tuple[float, float]:
    """Return the lowest and highest coordinate of the first `count` points, with a margin [m]."""
    low, high = math.inf, -math.inf
    for i in range(count):
        low, high = min(low, points[i, axis]), max(high, points[i, axis])
    return low - SLACK_M, high + SLACK_M


@compiled()
def _cut(polygon: Floats, out: Floats, corners: int, axis: int, sign: float, bound: float) -> int:
    """Clip a convex polygon by ``sign * p[axis] >= bound`` into `out`; return its number of corners.

    Sutherland and Hodgman, "Reentrant polygon clipping", 1974.
    """
    count = 0
    for i in range(corners):
        j = (i + 1) % corners
        a, b = sign * polygon[i, axis] - bound, sign * polygon[j, axis] - bound
        if a >= 0.0:
            for k in range(3):
                out[count, k] = polygon[i, k]
            count += 1
        if (a >= 0.0) != (b >= 0.0):
            for k in range(3):
                out[count, k] = polygon[i, k] + (polygon[j, k] - polygon[i, k]) * (a / (a - b))
            count += 1
    return count


def _dilate_levels(bands: Bands, cell: float, largest_radius_m: float) -> tuple[Floats, Ints, Bands]:
    """Return `radii`, `level_shape` and the concatenated bands of the levels; the first level is `bands`."""
    radii, shapes, parts = [0.0], [(0, bands.shape[1], bands.shape[0], 1)], [bands.ravel()]
    stride, offset = 1, bands.size
    while radii[-1] < largest_radius_m:
        blocks = _block_union(bands, stride)
        for reach in FINE_REACHES if stride == 1 else COARSE_REACHES:
            level = _dilated(blocks, reach)
            radii.append(reach * stride * cell)
            shapes.append((offset, level.shape[1], level.shape[0], stride))
            parts.append(level.ravel())
            offset += level.size
        stride *= 2
    return np.array(radii), np.array(shapes, np.int32), np.concatenate(parts)


def _block_union(bands: Bands, stride: int) -> Bands:
    """Return the bands of each block of `stride` by `stride` cells."""
    ny, nx = bands.shape
    padded = np.pad(bands, ((0, -ny % stride), (0, -nx % stride)))
    blocks = padded.reshape(padded.shape[0] // stride, stride, padded.shape[1] // stride, stride)
    return np.asarray(np.bitwise_or.reduce(np.bitwise_or.reduce(blocks, axis=3), axis=1), np.int64)


@compiled()
def _dilated(bands: Bands, reach: int) -> Bands:
    """Return the bands within `reach` cells of any point of each cell."""
    ny, nx = bands.shape
    out = np.zeros_like(bands)
    for iy in range(ny):
        for up in range(-reach, reach + 1):
            if not 0 <= iy + up < ny:
                continue
            across = math.ceil(math.sqrt(reach**2 - max(abs(up) - 1, 0) ** 2))
            for ix in range(nx):
                if bands[iy, ix] != 0:
                    for near in range(max(0, ix - across), min(nx, ix + across + 1)):
                        out[iy + up, near] |= bands[iy, ix]
    return out


def _distances(bands: Bands, cell: float) -> Singles:
    """Return a lower bound of the distance to the nearest cell that is not empty.

    It is the distance between the centers of the cells, minus the diagonal of a cell.
    """
    from scipy.ndimage import distance_transform_edt  # not needed when the grid is cached

    if not bands.any():  # the transform would measure the distance to a cell that does not exist
        return np.full(bands.shape, np.inf, np.float32)
    centers: Floats = distance_transform_edt(bands == 0) * cell
    return np.maximum(centers - math.sqrt(2.0) * cell - SLACK_M, 0.0).astype(np.float32)


@compiled(inline="always")
def bands_near(grid: HeightGrid, level: int, x: float, y: float) -> int:
    """Return the bands of height with obstacles within the radius of the level of (x, y)."""
    offset, nx, ny, stride = grid.level_shape[level]
    ix = math.floor((x - grid.frame[0]) / (grid.frame[2] * stride))
    iy = math.floor((y - grid.frame[1]) / (grid.frame[2] * stride))
    if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
        return 0  # the margin of the grid is wider than every radius
    return int(grid.palette[grid.levels[offset + iy * nx + ix]])


@compiled(inline="always")
def distance_at(grid: HeightGrid, x: float, y: float) -> float:
    """Return a lower bound of the distance from (x, y) to an obstacle [m]."""
    ny, nx = grid.distances.shape
    left, lower, cell = grid.frame[0], grid.frame[1], grid.frame[2] * DISTANCE_STRIDE
    ix, iy = math.floor((x - left) / cell), math.floor((y - lower) / cell)
    if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
        beyond_x = max(left - x, x - left - nx * cell, 0.0)
        beyond_y = max(lower - y, y - lower - ny * cell, 0.0)
        return math.sqrt(beyond_x * beyond_x + beyond_y * beyond_y)
    return float(grid.distances[iy, ix])


@compiled_bare
def first_hit(grid: HeightGrid, line: Line, begin: float, end: float) -> float:
    """Return the closest hit of a ray between two of its parameters, or infinity, by traversing the grid.

    Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987. A cell is skipped if the ray
    passes above or below everything in it. A hit on a triangle of a visited cell may be slightly beyond
    `end`.

    Args:
        grid: the harbor.
        line: x, y, z of the ray's origin [m] and of its direction, in the world frame.
        begin, end: ray parameters.
    """
    ox, oy, oz, dx, dy, dz = line
    levels, palette, starts = grid.levels, grid.palette, grid.starts
    members, triangles = grid.members, grid.triangles
    nx, ny = grid.level_shape[0, 1], grid.level_shape[0, 2]
    left, lower, cell = grid.frame
    px, py, vx, vy = (ox - left) / cell, (oy - lower) / cell, dx / cell, dy / cell  # in cells
    if not (_inside(px + begin * vx, nx) and _inside(px + end * vx, nx)):
        begin, end = _within(px, vx, nx, begin, end)
    if not (_inside(py + begin * vy, ny) and _inside(py + end * vy, ny)):
        begin, end = _within(py, vy, ny, begin, end)
    if begin > end:
        return MISS
    ix = min(max(math.floor(px + begin * vx), 0), nx - 1)
    iy = min(max(math.floor(py + begin * vy), 0), ny - 1)
    step_x, step_y = (1 if vx > 0.0 else -1), (1 if vy > 0.0 else -1)
    per_x, per_y = (1.0 / vx if vx != 0.0 else MISS), (1.0 / vy if vy != 0.0 else MISS)
    across_x, across_y = abs(per_x), abs(per_y)
    next_x = (ix + (vx > 0.0) - px) * per_x if vx != 0.0 else MISS
    next_y = (iy + (vy > 0.0) - py) * per_y if vy != 0.0 else MISS
    best = MISS
    entry = begin
    while True:
        t_exit = min(next_x, next_y)
        z_in, z_out = oz + dz * entry, oz + dz * min(t_exit, end)
        low, high = band_at(min(z_in, z_out)), band_at(max(z_in, z_out))
        place = iy * nx + ix
        if palette[levels[place]] & bits(low, high):
            for slot in range(starts[place], starts[place + 1]):
                member = members[slot]
                if member.low <= high and member.high >= low:
                    t = hit_triangle(triangles[member.triangle], ox, oy, oz, dx, dy, dz)
                    if t < best:
                        best = t
        if best <= t_exit or t_exit >= end:
            return best
        entry = t_exit
        if next_x < next_y:
            ix += step_x
            next_x += across_x
        else:
            iy += step_y
            next_y += across_y
        if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
            return best


@compiled(inline="always")
def _inside(p: float, cells: int) -> bool:
    return 0.0 <= p < cells


@compiled_bare
def _within(p: float, v: float, cells: int, begin: float, end: float) -> tuple[float, float]:
    """Return the part of ``begin .. end`` with ``p + t v`` inside the grid; begin > end if there is none."""
    if v == 0.0:
        return MISS, end
    a, b = -p / v, (cells - p) / v
    return max(begin, min(a, b)), min(end, max(a, b))
