"""A grid over the harbor's plan: how high it rises in each cell, and which triangles stand there.

The grid serves the fast LiDAR scan. It answers three questions, all on the safe side: how high does anything
rise within a radius of a point, how far is the nearest thing, and which triangles can a ray meet in a cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dockctl.sim.raycast import MISS, corner_and_edges, hit_triangle

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]

FINEST_CELL_M = 0.1
MOST_CELLS = 4_000_000
SMALLEST_RADIUS_M = 0.15
RADIUS_GROWTH = 1.4
EMPTY = np.float32(-1.0)
SLACK_M = 1e-5  # outweighs every rounding, in float32 too


@dataclass(frozen=True, eq=False)
class HeightGrid:
    """Heights, triangle lists and distances on a grid of square cells; rows run along y.

    Attributes:
        frame: (3,) x and y of the lower corner, and the cell's side [m].
        heights: (ny, nx) highest point in each cell [m], -1 where empty.
        starts, members: triangles of cell ``iy * nx + ix`` are ``members[starts[cell]:starts[cell + 1]]``.
        triangles: (m, 9) as `hit_triangle` takes them.
        distances: (ny, nx) from anywhere in a cell to the nearest cell that is not empty, at least [m].
        radii: (levels,) [m].
        level_shape: (levels, 4) offset into `dilated`, nx, ny and stride in cells of each level.
        dilated: levels end to end: highest point within the level's radius of anywhere in a cell [m].
    """

    frame: Floats
    heights: Singles
    starts: Ints
    members: Ints
    triangles: Floats
    distances: Singles
    radii: Floats
    level_shape: Ints
    dilated: Singles

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
        heights = np.full((ny, nx), EMPTY, np.float32)
        _lay(above, frame, heights, counts, np.empty(0, np.int32))
        starts = np.concatenate([[0], np.cumsum(counts[:-1])]).astype(np.int32)
        members = np.empty(starts[-1], np.int32)
        _lay(above, frame, heights, starts[:-1].copy(), members)
        shapes, dilated = _dilate_levels(heights, radii, cell)
        return cls(
            frame=frame,
            heights=heights,
            starts=starts,
            members=members,
            triangles=corner_and_edges(above),
            distances=_distances(heights, cell),
            radii=radii,
            level_shape=shapes,
            dilated=dilated,
        )

    def levels_for(self, radii_m: Floats) -> Ints:
        """Return the first level whose radius is at least each of the (k,) radii [m]."""
        return np.searchsorted(self.radii, radii_m).astype(np.int32)

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """What the compiled scan takes, in its order."""
        return (
            self.frame,
            self.heights,
            self.starts,
            self.members,
            self.triangles,
            self.distances,
            self.level_shape,
            self.dilated,
        )


@njit(cache=True)
def _lay(triangles: Floats, frame: Floats, heights: Singles, places: Ints, members: Ints) -> None:
    """Enter each triangle in the cells that its plan touches: count where `members` is empty, else fill.

    A cell's height is the lower of two bounds of the triangle there: its highest corner, and its plane.
    """
    ny, nx = heights.shape
    x0, y0, cell = frame
    for index in range(len(triangles)):
        t = triangles[index]
        low_x, high_x = t[:, 0].min() - SLACK_M, t[:, 0].max() + SLACK_M
        low_y, high_y = t[:, 1].min() - SLACK_M, t[:, 1].max() + SLACK_M
        top = t[:, 2].max()
        ux, uy, uz = t[1] - t[0]
        vx, vy, vz = t[2] - t[0]
        area = ux * vy - uy * vx  # twice the plan's, signed
        steep = abs(area) < 1e-9
        slope_x = 0.0 if steep else (uz * vy - vz * uy) / area
        slope_y = 0.0 if steep else (vz * ux - uz * vx) / area
        for iy in range(max(0, int((low_y - y0) / cell)), min(ny - 1, int((high_y - y0) / cell)) + 1):
            for ix in range(max(0, int((low_x - x0) / cell)), min(nx - 1, int((high_x - x0) / cell)) + 1):
                cx, cy = x0 + (ix + 0.5) * cell, y0 + (iy + 0.5) * cell
                if _outside(t, cx, cy, cell / 2 + SLACK_M):
                    continue
                place = iy * nx + ix
                if len(members) > 0:
                    members[places[place]] = index
                places[place] += 1
                height = top
                if not steep:
                    plane = t[0, 2] + slope_x * (cx - t[0, 0]) + slope_y * (cy - t[0, 1])
                    height = min(top, plane + (abs(slope_x) + abs(slope_y)) * (cell / 2 + SLACK_M))
                if height + SLACK_M > heights[iy, ix]:
                    heights[iy, ix] = max(height, 0.0) + SLACK_M


@njit(cache=True)
def _outside(t: Floats, cx: float, cy: float, half: float) -> bool:
    """Tell whether one of the triangle's edges separates its plan from the square around (cx, cy)."""
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        nx, ny = t[j, 1] - t[i, 1], t[i, 0] - t[j, 0]
        other = nx * (t[k, 0] - t[i, 0]) + ny * (t[k, 1] - t[i, 1])
        if other > 0:
            nx, ny, other = -nx, -ny, -other
        # Now the triangle lies where the normal's value is between `other` and 0.
        centre = nx * (cx - t[i, 0]) + ny * (cy - t[i, 1])
        reach = (abs(nx) + abs(ny)) * half
        if centre - reach > 0.0 or centre + reach < other:
            return True
    return False


def _dilate_levels(heights: Singles, radii: Floats, cell: float) -> tuple[Ints, Singles]:
    """Return `level_shape` and `dilated` for the radii; a wide radius needs no fine cells."""
    shapes, parts, offset = [], [], 0
    for radius in radii:
        stride = max(1, 2 ** int(math.log2(max(1.0, radius / cell / 3))))
        coarse = _block_maximum(heights, stride)
        level = _window_maximum(coarse, math.ceil(radius / (cell * stride)))
        shapes.append((offset, level.shape[1], level.shape[0], stride))
        parts.append(level.ravel())
        offset += level.size
    return np.array(shapes, np.int32), np.concatenate(parts)


def _block_maximum(heights: Singles, stride: int) -> Singles:
    ny, nx = heights.shape
    padded = np.pad(heights, ((0, -ny % stride), (0, -nx % stride)), constant_values=EMPTY)
    blocks = padded.reshape(padded.shape[0] // stride, stride, padded.shape[1] // stride, stride)
    return np.asarray(blocks.max(axis=(1, 3)), np.float32)


def _window_maximum(heights: Singles, reach: int) -> Singles:
    """Return the maximum over the square window of `reach` cells to every side."""
    for axis in (0, 1):
        pad = [(0, 0), (0, 0)]
        pad[axis] = (reach, reach)
        padded = np.pad(heights, pad, constant_values=EMPTY)
        heights = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1, axis).max(axis=-1)
    return np.ascontiguousarray(heights, np.float32)


@njit(cache=True)
def _distances(heights: Singles, cell: float) -> Singles:
    """Return a lower bound of the distance to the nearest cell that is not empty.

    Exact squared distances between cell centres by lower envelopes of parabolas (Felzenszwalb and
    Huttenlocher, "Distance transforms of sampled functions", 2012), less a cell's diagonal.
    """
    ny, nx = heights.shape
    far = 1e12
    squared = np.where(heights >= 0.0, 0.0, far)
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


@njit(cache=True, nogil=True)
def first_hit(
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
    begin: float,
    end: float,
    frame: Floats,
    heights: Singles,
    starts: Ints,
    members: Ints,
    triangles: Floats,
) -> float:
    """Walk a ray between two of its parameters, cell by cell, to its closest hit there or infinity.

    As in Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", 1987; a cell that the ray
    passes above is skipped. A hit on a triangle of a visited cell also counts just past `end`.

    Args:
        ox, oy, oz, dx, dy, dz: origin [m] and direction in the world frame.
        begin, end: ray parameters.
        frame, heights, starts, members, triangles: of the `HeightGrid`.
    """
    ny, nx = heights.shape
    cell = frame[2]
    # Into cell coordinates, and cut to the grid.
    px, py, vx, vy = (ox - frame[0]) / cell, (oy - frame[1]) / cell, dx / cell, dy / cell
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
        lowest = oz + dz * (min(leave, end) if dz < 0.0 else entry)
        if lowest <= heights[iy, ix]:
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
