"""Distances from obstacles on a grid in plan view, for the approximate clearance of many poses at once."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dockctl.compute import compiled
from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.solids import hull_outline
from dockctl.sim.harbor.waters import outline_at_hull, points_along

CELL_M = 0.05
OUTLINE_M = 0.25
"""Maximum spacing of the points of the hull at which the distance is looked up."""
BEYOND_M = 1.0
"""Width of the water around the obstacles in the grid; beyond it, distances are those at its edge."""
MAX_CELLS = 100_000_000
STEPS = 4
"""Number of steps per cell to which distances are rounded down."""
FARTHEST = np.iinfo(np.uint8).max
"""Distance [steps] of all that is farther: 64 cells, 3.2 m."""


@compiled()
def nearest(distances: Any, low: Any, cell: float, points: Any, eta: Any) -> Any:
    """Return the smallest distance (n,) [steps] at points (k, 2) of the hull, for poses (n, 3)."""
    least = np.full(len(eta), FARTHEST, distances.dtype)
    rows, columns = distances.shape
    for i, (x, y, heading) in enumerate(eta):
        cosine, sine = math.cos(heading), math.sin(heading)
        for ahead, port in points:
            row = (x + cosine * ahead - sine * port - low[0]) / cell
            column = (y + sine * ahead + cosine * port - low[1]) / cell
            inside = int(min(max(row, 0), rows - 1)), int(min(max(column, 0), columns - 1))
            least[i] = min(least[i], distances[inside])
    return least


class DistanceField:
    """Distance to the nearest obstacle between keel and deck; infinite beyond 3.2 m.

    The distance of a hull is that of the nearest of the points on its outline, to the nearest edge of an
    obstacle; it is about 0.05 m off, more where the corner of an obstacle is between two points. Inside an
    obstacle it is the distance to its edge, too: a path must be sampled so densely that it shows how the hull
    got there.

    Args:
        triangles: (m, 3, 3) surface of the harbor [m].
        hull: of the boat.
    """

    def __init__(self, triangles: Floats, hull: Hull) -> None:
        from scipy.ndimage import distance_transform_edt  # slow to import

        edges = outline_at_hull(triangles, hull)
        corners = edges.reshape(-1, 2) if len(edges) else np.zeros((1, 2))
        self._low = corners.min(axis=0) - BEYOND_M
        size = corners.max(axis=0) + BEYOND_M - self._low
        self._cell = max(CELL_M, float(np.sqrt(size.prod() / MAX_CELLS)))  # coarser in square kilometers
        open_water = np.ones(np.ceil(size / self._cell).astype(int) + 1, bool)
        if len(edges):
            cells = (points_along(edges, self._cell / 2) - self._low) / self._cell
            open_water[tuple(cells.astype(int).T)] = False
            distances = STEPS * distance_transform_edt(open_water)
            self._distances = np.minimum(distances, FARTHEST).astype(np.uint8)  # about 2.7 MB for a marina
        else:
            self._distances = np.full(open_water.shape, FARTHEST, np.uint8)
        outline = hull_outline(hull)
        self._points = points_along(np.stack([outline, np.roll(outline, -1, axis=0)], axis=1), OUTLINE_M)

    def clearance(self, eta: Floats) -> Floats:
        """Return the approximate distance of the hull from the nearest obstacle, (..., 3) to (...) [m]."""
        steps = nearest(self._distances, self._low, self._cell, self._points, eta.reshape(-1, 3))
        found: Floats = np.where(steps == FARTHEST, np.inf, steps * (self._cell / STEPS))
        return found.reshape(eta.shape[:-1])
