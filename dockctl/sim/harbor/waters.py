"""Which parts of a harbor's water are connected, on a grid in plan view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dockctl.geometry import Bools, Floats, Ints
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.solids import hull_outline

SECTIONS = 5
"""Heights between keel and deck at which obstacles are cut."""
CELLS_PER_RADIUS = 3
"""The boat's origin is farther from obstacles than the radius of the largest circle in its outline. Cells
smaller than 1 / (2 sqrt(2)) of it therefore separate no two poses between which the boat can move."""
MAX_CELLS = 20_000_000


def cross_section(triangles: Floats, z: float) -> tuple[Floats, Ints]:
    """Return where triangles (m, 3, 3) intersect the horizontal plane at `z` [m].

    A corner at `z` counts as above it, and both triangles of an edge interpolate from its lower to its upper
    end: the segments of a closed mesh form closed chains, exactly.

    Returns:
        Directed segments (k, 2, 2) [m], and the triangle of each, (k,).
    """
    above = triangles[:, :, 2] >= z
    mixed = np.flatnonzero(above.any(axis=1) & ~above.all(axis=1))
    corners, above = triangles[mixed], above[mixed]
    following, above_next = np.roll(corners, -1, axis=1), np.roll(above, -1, axis=1)
    ends: list[Floats] = []
    for rises in (above_next & ~above, above & ~above_next):
        edge = rises.argmax(axis=1)
        rows = np.arange(len(edge))
        a, b = corners[rows, edge], following[rows, edge]
        low, high = (a, b) if len(ends) == 0 else (b, a)
        ends.append(low[:, :2] + ((z - low[:, 2]) / (high[:, 2] - low[:, 2]))[:, None] * (high - low)[:, :2])
    return np.stack(ends, axis=1), mixed


def outline_at_hull(triangles: Floats, hull: Hull) -> Floats:
    """Return the edges (k, 2, 2) [m] of what triangles (m, 3, 3) enclose at heights between keel and deck."""
    heights = np.linspace(-hull.draft_m, hull.freeboard_m, SECTIONS)
    return np.concatenate([cross_section(triangles, z)[0] for z in heights])


def connected_cells(cells: Bools) -> tuple[NDArray[np.int32], int]:
    """Label the sets of true cells (rows, columns) that are connected by sides, from 1; other cells are 0.

    Returns:
        The number of each cell's set, (rows, columns), and the number of sets.
    """
    # `scipy.ndimage.label` gives the same numbers; importing it takes longer than everything else here.
    # Runs of true cells in a row, as positions in the flattened rows, which one false cell separates.
    width = cells.shape[1] + 1
    separated = np.zeros((len(cells), width), np.int8)
    separated[:, :-1] = cells
    steps = np.diff(separated.ravel(), prepend=0, append=0)
    begin, end = np.flatnonzero(steps > 0), np.flatnonzero(steps < 0)
    sets = list(range(len(begin)))  # for each run, an earlier run of its set, or itself (union-find)

    def first_of(run: int) -> int:
        while sets[run] != run:
            sets[run] = run = sets[sets[run]]
        return run

    below = np.searchsorted(end, begin + width, side="right"), np.searchsorted(begin, end + width)
    for run, touched in enumerate(zip(*(limit.tolist() for limit in below), strict=True)):
        for other in range(*touched):
            first, second = sorted((first_of(run), first_of(other)))
            sets[second] = first
    firsts, number = np.unique([first_of(run) for run in range(len(sets))], return_inverse=True)
    numbers = np.zeros(cells.shape, np.int32)
    numbers[cells] = np.repeat(number + 1, end - begin)
    return numbers, len(firsts)


class Waters:
    """Regions of water between which a boat cannot move.

    Within one region, a gap may still be too narrow for it.

    Args:
        triangles: (m, 3, 3) surface of the harbor [m]; open surfaces separate as closed ones do.
        hull: of the boat.
    """

    def __init__(self, triangles: Floats, hull: Hull) -> None:
        segments = outline_at_hull(triangles, hull)
        self._cell = _inner_radius(hull_outline(hull)) / CELLS_PER_RADIUS
        corners = segments.reshape(-1, 2) if len(segments) else np.zeros((1, 2))
        self._low = corners.min(axis=0) - 2 * self._cell
        shape = np.ceil((corners.max(axis=0) - self._low) / self._cell) + 2
        if np.prod(shape) > MAX_CELLS:  # a harbor of square kilometers: treated as one region
            self._regions = np.ones((1, 1), np.int32)
            return
        open_water = np.ones(shape.astype(int), bool)
        cells = (points_along(segments, self._cell / 2) - self._low) / self._cell
        open_water[tuple(cells.astype(int).T)] = False
        regions, count = connected_cells(open_water)
        self._regions = regions.astype(np.min_scalar_type(count))

    def region(self, eta: Floats) -> Ints:
        """Return the region of the origin of each pose, 0 on the edge of an obstacle, (n, 3) to (n,)."""
        cells = np.floor((eta[:, :2] - self._low) / self._cell)
        x, y = np.clip(cells, 0, np.array(self._regions.shape) - 1).astype(int).T
        return np.asarray(self._regions[x, y], np.int64)


def points_along(segments: Floats, spacing: float) -> Floats:
    """Return points (k, 2) on segments (m, 2, 2), both ends and at most `spacing` apart."""
    begin, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    counts = np.ceil(np.hypot(*along.T) / spacing).astype(int) + 1
    of = np.repeat(np.arange(len(segments)), counts)
    number = np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)
    fraction = number / np.maximum(counts[of] - 1, 1)
    return np.asarray(begin[of] + fraction[:, None] * along[of])


def _inner_radius(outline: Floats) -> float:
    """Return the distance from the body's origin to the nearest side of an outline (k, 2) [m]."""
    along = np.roll(outline, -1, axis=0) - outline
    return float(
        np.min(np.abs(along[:, 0] * outline[:, 1] - along[:, 1] * outline[:, 0]) / np.hypot(*along.T))
    )
