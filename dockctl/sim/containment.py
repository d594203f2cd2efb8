"""Which part of a harbor contains the hull, or is inside it, without contact of their surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dockctl.geometry import Floats, Ints
from dockctl.sim.harbor.solids import Mesh
from dockctl.sim.harbor.waters import cross_section

Body = tuple[int, Mesh]


class Interior:
    """Finds the part that contains a point at the height `z`, by winding numbers in a cross-section.

    Bodies that are not closed contain nothing.
    """

    def __init__(self, bodies: Sequence[Body], z: float) -> None:
        bodies = [
            (part, mesh)
            for part, mesh in bodies
            if mesh.bounds[0, 2] <= z <= mesh.bounds[1, 2] and mesh.is_watertight
        ]
        triangles = np.concatenate([np.empty((0, 3, 3)), *(mesh.triangles for _, mesh in bodies)])
        body = np.repeat(np.arange(len(bodies)), [len(mesh.faces) for _, mesh in bodies])
        self._segments, cut = cross_section(triangles, z)
        self._body = body[cut]
        self._part_of_body = np.array([*(part for part, _ in bodies), -1])

    def part_at(self, eta: Floats) -> Ints:
        """Return the part that contains the origin of each pose, -1 for none, (n, 3) to (n,)."""
        return np.array([self._part_containing(x, y) for x, y, _ in eta], np.int64)

    def _part_containing(self, x: float, y: float) -> int:
        (x0, y0), (x1, y1) = self._segments.transpose(1, 2, 0)
        crossed = np.flatnonzero((y0 <= y) != (y1 <= y))  # half-open: a shared corner counts once
        x0, y0, x1, y1 = x0[crossed], y0[crossed], x1[crossed], y1[crossed]
        right = x0 + (y - y0) / (y1 - y0) * (x1 - x0) > x
        turns = np.bincount(self._body[crossed[right]], np.sign(y1 - y0)[right], minlength=1)
        return int(self._part_of_body[np.argmax(turns != 0) if turns.any() else -1])


class InsideHull:
    """Finds the part inside the hull without contact: bodies that are small enough, tested by one corner."""

    def __init__(self, bodies: Sequence[Body], hull: Mesh) -> None:
        reach = np.linalg.norm(hull.extents[:2])
        low, high = hull.bounds[:, 2]
        small = [
            (part, mesh.vertices[0])
            for part, mesh in bodies
            if mesh.bounds[0, 2] > low and mesh.bounds[1, 2] < high and mesh.extents[:2].max() < reach
        ]
        self._parts = np.array([part for part, _ in small], np.int64)
        self._points = np.array([point for _, point in small]).reshape(-1, 3)
        self._normals = hull.normals
        self._offsets = np.einsum("ij,ij->i", hull.normals, hull.triangles[:, 0])

    def part_in(self, eta: Floats) -> Ints:
        """Return the part inside the hull at each pose, -1 for none, (n, 3) to (n,)."""
        found = np.full(len(eta), -1)
        for row, (x, y, heading) in enumerate(eta if len(self._parts) else ()):
            shifted = self._points - (x, y, 0.0)
            cosine, sine = np.cos(heading), np.sin(heading)
            body = shifted @ np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
            inside = (body @ self._normals.T < self._offsets).all(axis=1)  # the hull is convex
            if inside.any():
                found[row] = self._parts[inside.argmax()]
        return found
