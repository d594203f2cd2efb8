"""Distances from obstacles on a grid in plan view, for the approximate clearance of many poses at once."""

from __future__ import annotations

import numpy as np

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


class DistanceField:
    """Distance to the nearest obstacle between keel and deck.

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
            self._distance = (distance_transform_edt(open_water) * self._cell).astype(np.float32)
        else:
            self._distance = np.full(open_water.shape, np.inf, np.float32)
        outline = hull_outline(hull)
        self._points = points_along(np.stack([outline, np.roll(outline, -1, axis=0)], axis=1), OUTLINE_M)

    def clearance(self, eta: Floats) -> Floats:
        """Return the approximate distance of the hull from the nearest obstacle, (..., 3) to (...) [m]."""
        cosine, sine = np.cos(eta[..., 2, None]), np.sin(eta[..., 2, None])
        ahead, port = self._points.T
        x = eta[..., 0, None] + cosine * ahead - sine * port
        y = eta[..., 1, None] + sine * ahead + cosine * port
        cells = [
            np.clip((along - low) / self._cell, 0, count - 1).astype(np.int64)
            for along, low, count in zip((x, y), self._low, self._distance.shape, strict=True)
        ]
        return np.asarray(self._distance[tuple(cells)].min(axis=-1), float)
