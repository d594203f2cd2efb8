"""A grid over the harbor in plan view: the heights of obstacles and the triangles in each cell.

The fast LiDAR scan uses it for conservative answers to three questions: at which heights there are obstacles
within a radius of a point, how far away the nearest one is, and which triangles a ray can hit in a cell.
Heights are sets of bands, one bit each, because a ray may pass between a deck and a boom, or under a stay.
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

Ints = NDArray[np.int32]
Indices = NDArray[np.uint32]  # unsigned: compiled code skips the handling of negative indices
Bands = NDArray[np.int64]
Members = NDArray[np.void]
Line = tuple[float, float, float, float, float, float]

FINEST_CELL_M = 0.1
MAX_CELLS = 4_000_000
MAX_MEMBERS = 100_000_000
"""Maximum number of triangles in all cells together; each takes 6 bytes."""
# Radii of the levels, in cells: these, then 3, 4, 5 times 2, 4, 8 ... on cells enlarged by the same factor.
FINE_REACHES = (1, 2, 3, 4)
COARSE_REACHES = (3, 4, 5)
DISTANCE_STRIDE = 2
SLACK_M = 1e-5  # greater than any rounding error, also in float32

DISTANCE_STEP_M = 0.01
FARTHEST = 65535
TILE = 8  # `in_tiles` uses shifts
MEMBER = np.dtype([("triangle", np.int32), ("low", np.uint8), ("high", np.uint8)])
SMALL_MEMBER = np.dtype([("triangle", np.uint16), ("low", np.uint8), ("high", np.uint8)])


@compiled(inline="always")
def floor(x: float) -> int:
    """Return the largest integer up to x; compiled for a GPU, `math.floor` returns a float."""
    return int(math.floor(x))  # noqa: RUF046


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

    Most of a harbor is open water or land, and few sets of bands occur. The cells are therefore stored in
    tiles of `TILE` by `TILE`, identical tiles only once, as indices into `palette` instead of sets of bands.

    Attributes:
        frame: (3,) x and y of the lower corner, and the cell size [m].
        radii: (levels,) [m]; the first is 0.
        level_shape: (levels, 4) offset into `directory`, nx, ny and stride in cells of each level.
        directory: indices into `tiles`, for each level and tile of cells.
        tiles: (k, TILE * TILE) for each cell of a level, the bands within the radius of the level of any
            point of the cell; indices into `palette`.
        palette: (sets,) sets of bands with obstacles; the first is 0.
        list_directory, list_tiles: likewise, the triangle list of each cell.
        starts, members: the triangles of a list are ``members[starts[list]:starts[list + 1]]``, with their
            lowest and highest band in the cell; list 0 is empty.
        triangles: (m, 9) in the form of `hit_triangle`, neighbors together.
        distances: lower bound on the distance from any point of a block of cells to a nonempty cell, in
            multiples of `DISTANCE_STEP_M`.
    """

    frame: Floats
    radii: Floats
    level_shape: Ints
    directory: Indices
    tiles: NDArray[np.unsignedinteger[Any]]
    palette: Bands
    list_directory: Indices
    list_tiles: Indices
    starts: Indices
    members: Members
    triangles: Floats
    distances: NDArray[np.uint16]

    @classmethod
    def build(cls, triangles: Floats, largest_radius_m: float) -> HeightGrid:
        """Build the grid over (m, 3, 3) triangles [m], with levels up to at least `largest_radius_m`.

        Raises:
            DockctlError: the triangles overlap in so many cells that the grid would be too large.
        """
        above = triangles[triangles[:, :, 2].max(axis=1, initial=-math.inf) >= 0.0]
        corners = above.reshape(-1, 3)[:, :2] if len(above) else np.zeros((1, 2))
        margin = largest_radius_m + 1.0
        low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
        cell = max(FINEST_CELL_M, math.sqrt(float(np.prod(high - low)) / MAX_CELLS))
        low, high = low - 2.0 * cell, high + 2.0 * cell  # the outermost cells must be empty
        nx, ny = (math.ceil(side / cell) for side in high - low)
        touched = (np.ptp(above[:, :, :2], axis=1) // cell + 2).prod(axis=1).sum()
        if touched > MAX_MEMBERS:
            raise DockctlError(
                f"harbor: its triangles overlap in plan view: they cover {touched:,.0f} cells of {cell:.2g} m"
                f" of the LiDAR's grid, at most {MAX_MEMBERS:,}; simplify its meshes",
                code="out_of_range",
            )
        frame = np.array([low[0], low[1], cell])
        counts = np.zeros(-(-nx // TILE) * -(-ny // TILE) * TILE**2 + 1, np.int32)
        bands = np.zeros((ny, nx), np.int64)
        _rasterize(above, frame, bands, counts, np.empty(0, MEMBER))
        starts = np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.uint32)
        members = np.empty(starts[-1], MEMBER)
        _rasterize(above, frame, bands, starts[:-1].astype(np.int32), members)
        radii, shapes, levels = _dilate_levels(bands, cell, largest_radius_m)
        palette = np.unique(np.concatenate([np.unique(level) for level in levels]))
        index_type = np.uint16 if len(palette) <= 1 << 16 else np.uint32
        tiles, directory = _unique_rows(
            np.concatenate([_tiled(np.searchsorted(palette, level).astype(index_type)) for level in levels])
        )
        lists, starts, members = _unique_lists(counts[:-1], starts, members)
        list_tiles, list_directory = _unique_rows(lists.reshape(-1, TILE**2))
        # Neighboring triangles together: the cells along a ray then share cache lines.
        used, first = np.unique(members["triangle"], return_index=True)
        order = used[np.argsort(first)]
        place = np.zeros(len(above), np.int32)
        place[order] = np.arange(len(order))
        members["triangle"] = place[members["triangle"]]
        return cls(
            frame=frame,
            radii=radii,
            level_shape=shapes,
            directory=directory,
            tiles=tiles,
            palette=palette,
            list_directory=list_directory,
            list_tiles=list_tiles,
            starts=starts,
            members=members.astype(SMALL_MEMBER) if len(order) <= 1 << 16 else members,
            triangles=corner_and_edges(above[order]),
            distances=_distances(_block_union(bands, DISTANCE_STRIDE), cell * DISTANCE_STRIDE),
        )


def _tiled(cells: NDArray[Any]) -> NDArray[Any]:
    """Return the tiles of a level, (k, TILE * TILE), row by row; cells beyond its edges are 0."""
    ny, nx = cells.shape
    padded = np.pad(cells, ((0, -ny % TILE), (0, -nx % TILE)))
    tiles = padded.reshape(len(padded) // TILE, TILE, -1, TILE).swapaxes(1, 2)
    return tiles.reshape(-1, TILE**2)


def _unique_rows(rows: NDArray[Any]) -> tuple[NDArray[Any], Indices]:
    """Return the distinct rows, in the order of their first occurrence, and the index of each row in them."""
    whole = np.dtype((np.void, rows.shape[1] * rows.itemsize))
    keys = np.ascontiguousarray(rows).view(whole).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return rows[first[order]], np.argsort(order)[inverse].astype(np.uint32)


def _unique_lists(counts: Ints, starts: Indices, members: Members) -> tuple[Indices, Indices, Members]:
    """Return the list of each cell, and `starts` and `members` with equal lists of one triangle stored once.

    On land, most cells contain one triangle, and all of it in the same bands.
    """
    single, several = counts == 1, counts > 1
    rows = members[starts[:-1][single]].view(np.uint8).reshape(-1, MEMBER.itemsize)
    singles, index = _unique_rows(rows)
    lists = np.zeros(len(counts), np.uint32)
    lists[single] = 1 + index
    lists[several] = 1 + len(singles) + np.arange(several.sum())
    lengths = np.concatenate([[0], np.ones(len(singles), int), counts[several]])
    kept = np.concatenate([singles.ravel().view(MEMBER), members[np.repeat(several, counts)]])
    return lists, np.concatenate([[0], np.cumsum(lengths)]).astype(np.uint32), kept


@compiled(inline="always")
def in_tiles(ix: int, iy: int, nx: int) -> int:
    """Return the index of a cell in the tile order of a level with nx cells per row."""
    tile, row, column = (iy >> 3) * ((nx + 7) >> 3) + (ix >> 3), iy & 7, ix & 7
    return (tile << 6) + (row << 3) + column


@compiled()
def _rasterize(triangles: Floats, frame: Floats, bands: Bands, places: Ints, members: Members) -> None:
    """Add each triangle, with its bands, to the cells that it touches in plan view.

    If `members` is empty, triangles are counted in `places`; otherwise they are written starting at `places`,
    whose cells are in tile order. Triangles under water are skipped, because rays end at the water surface.
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
                place = in_tiles(ix, iy, nx)
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


def _dilate_levels(bands: Bands, cell: float, largest_radius_m: float) -> tuple[Floats, Ints, list[Bands]]:
    """Return `radii`, `level_shape` and the bands of the levels; the first level is `bands`."""
    radii, strides, levels = [0.0], [1], [bands]
    stride = 1
    while radii[-1] < largest_radius_m:
        blocks = _block_union(bands, stride)
        for reach in FINE_REACHES if stride == 1 else COARSE_REACHES:
            if radii[-1] >= largest_radius_m:
                break
            radii.append(reach * stride * cell)
            strides.append(stride)
            levels.append(_dilated(blocks, reach))
        stride *= 2
    sizes = [-(-level.shape[0] // TILE) * -(-level.shape[1] // TILE) for level in levels]
    offsets = np.cumsum([0, *sizes[:-1]])
    shapes = [
        (offset, level.shape[1], level.shape[0], step)
        for offset, level, step in zip(offsets, levels, strides, strict=True)
    ]
    return np.array(radii), np.array(shapes, np.int32), levels


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


def _distances(bands: Bands, cell: float) -> NDArray[np.uint16]:
    """Return a lower bound on the distance to the nearest nonempty cell [DISTANCE_STEP_M].

    It is the distance between the centers of the cells, minus the diagonal of a cell.
    """
    from scipy.ndimage import distance_transform_edt  # not needed when the grid is cached

    if not bands.any():  # the transform would measure the distance to a cell that does not exist
        return np.full(bands.shape, FARTHEST, np.uint16)
    centers: Floats = distance_transform_edt(bands == 0) * cell
    least = np.maximum(centers - math.sqrt(2.0) * cell - SLACK_M, 0.0)
    return np.minimum(least / DISTANCE_STEP_M, FARTHEST).astype(np.uint16)


@compiled(inline="always")
def bands_near(grid: HeightGrid, level: int, x: float, y: float) -> int:
    """Return the bands of height with obstacles within the radius of the level of (x, y)."""
    offset, nx, ny, stride = grid.level_shape[level]
    ix = floor((x - grid.frame[0]) / (grid.frame[2] * stride))
    iy = floor((y - grid.frame[1]) / (grid.frame[2] * stride))
    if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
        return 0  # the margin of the grid is wider than every radius
    place = in_tiles(ix, iy, nx)
    return int(grid.palette[grid.tiles[grid.directory[offset + (place >> 6)], place & 63]])


@compiled(inline="always")
def bands_in(grid: HeightGrid, x: float, y: float, reach_x: float, reach_y: float) -> int:
    """Return the bands of height with obstacles in the cells that a box around (x, y) touches."""
    nx, ny = grid.level_shape[0, 1], grid.level_shape[0, 2]
    px, py = (x - grid.frame[0]) / grid.frame[2], (y - grid.frame[1]) / grid.frame[2]  # in cells
    reach_x, reach_y = reach_x / grid.frame[2], reach_y / grid.frame[2]
    bands = 0
    for iy in range(max(0, floor(py - reach_y)), min(ny, floor(py + reach_y) + 1)):
        for ix in range(max(0, floor(px - reach_x)), min(nx, floor(px + reach_x) + 1)):
            place = in_tiles(ix, iy, nx)
            bands |= grid.palette[grid.tiles[grid.directory[place >> 6], place & 63]]
    return int(bands)


@compiled(inline="always")
def distance_at(grid: HeightGrid, x: float, y: float) -> float:
    """Return a lower bound on the distance from (x, y) to an obstacle [m]."""
    ny, nx = grid.distances.shape
    left, lower, cell = grid.frame[0], grid.frame[1], grid.frame[2] * DISTANCE_STRIDE
    ix, iy = floor((x - left) / cell), floor((y - lower) / cell)
    if ix < 0 or iy < 0 or ix >= nx or iy >= ny:
        beyond_x = max(left - x, x - left - nx * cell, 0.0)
        beyond_y = max(lower - y, y - lower - ny * cell, 0.0)
        return math.sqrt(beyond_x * beyond_x + beyond_y * beyond_y)
    return float(grid.distances[iy, ix] * DISTANCE_STEP_M)


@compiled(inline="always")
def first_hit(grid: HeightGrid, line: Line, begin: float, end: float, bands: int) -> float:
    """Return the closest hit of a ray between two of its parameters, or infinity, by traversing the grid.

    Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987. A cell is skipped if the ray
    passes above or below everything in it.

    Args:
        grid: the harbor.
        line: x, y, z of the ray's origin [m] and of its direction, in the world frame.
        begin, end: ray parameters.
        bands: a set that contains the bands of the ray between them; -1 for all bands.
    """
    ox, oy, oz, dx, dy, dz = line
    directory, tiles, palette = grid.directory, grid.tiles, grid.palette
    starts, members, triangles = grid.starts, grid.members, grid.triangles
    nx, ny = grid.level_shape[0, 1], grid.level_shape[0, 2]
    per_meter = 1.0 / grid.frame[2]
    px, py = (ox - grid.frame[0]) * per_meter, (oy - grid.frame[1]) * per_meter  # in cells
    vx, vy = dx * per_meter, dy * per_meter
    if not (_inside(px + begin * vx, nx) and _inside(px + end * vx, nx)):
        begin, end = _within(px, vx, nx, begin, end)
    if not (_inside(py + begin * vy, ny) and _inside(py + end * vy, ny)):
        begin, end = _within(py, vy, ny, begin, end)
    best = MISS
    if begin <= end:
        ix, iy = floor(px + begin * vx), floor(py + begin * vy)
        step_x, step_y = (1 if vx > 0.0 else -1), (1 if vy > 0.0 else -1)
        per_x, per_y = (1.0 / vx if vx != 0.0 else MISS), (1.0 / vy if vy != 0.0 else MISS)
        across_x, across_y = abs(per_x), abs(per_y)
        next_x = (ix + (vx > 0.0) - px) * per_x if vx != 0.0 else MISS
        next_y = (iy + (vy > 0.0) - py) * per_y if vy != 0.0 else MISS
        entry = begin
        while True:
            t_exit = min(next_x, next_y)
            place = in_tiles(ix, iy, nx)
            tile, cell = np.uint64(place >> 6), np.uint64(place & 63)
            present = palette[tiles[directory[tile], cell]] & bands
            if present != 0:
                z_in, z_out = oz + dz * entry, oz + dz * min(t_exit, end)
                low, high = band_at(min(z_in, z_out)), band_at(max(z_in, z_out))
                if present & bits(low, high) != 0:
                    number = grid.list_tiles[grid.list_directory[tile], cell]
                    for slot in range(starts[number], starts[number + 1]):
                        member = members[slot]
                        if member.low <= high and member.high >= low:
                            t = hit_triangle(triangles[member.triangle], ox, oy, oz, dx, dy, dz)
                            if t <= end:
                                best = end = t
            if t_exit >= end:
                break
            entry = t_exit
            x_first = next_x < next_y
            ix += step_x if x_first else 0
            iy += 0 if x_first else step_y
            next_x += across_x if x_first else 0.0
            next_y += 0.0 if x_first else across_y
    return best


@compiled(inline="always")
def _inside(p: float, cells: int) -> bool:
    return 1.0 <= p < cells - 1


@compiled_bare
def _within(p: float, v: float, cells: int, begin: float, end: float) -> tuple[float, float]:
    """Return the part of ``begin .. end`` where ``p + t v`` is in the grid but not in its outermost cells.

    Return begin > end if there is none.
    """
    if v == 0.0:
        return MISS, end
    a, b = (1.0 - p) / v, (cells - 1 - p) / v
    return max(begin, min(a, b)), min(end, max(a, b))
