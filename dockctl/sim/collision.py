"""Contact and clearance between the boat and the harbor, exact, by python-fcl."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property

import fcl
import numpy as np
import trimesh

from dockctl.compute import shared
from dockctl.geometry import Bools, Floats, Ints, wrap
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.build import Harbor
from dockctl.sim.harbor.solids import hull_mesh
from dockctl.sim.harbor.waters import Waters, cross_section

SIZE_BY_TRIANGLES = 8
"""Memory of a checker, relative to the array of the harbor's triangles; measured on the reference marina."""


class CollisionChecker:
    """The hull of one boat in one harbor; poses are rows x, y [m], heading [rad].

    fcl compares surfaces and reports no contact for a boat inside a quay or a buoy inside the boat; `blocked`
    detects these cases, too.
    """

    def __init__(self, harbor: Harbor, hull: Hull) -> None:
        self.harbor, self.hull = harbor, hull
        boat = hull_mesh(hull)
        self._hull = _bvh([boat])
        self._solids = fcl.CollisionObject(_bvh([part.mesh for part in harbor.parts]))
        bodies = list(_closed_bodies(harbor))
        self._interior = _Interior(bodies, (hull.freeboard_m - hull.draft_m) / 2)
        self._inside_hull = _InsideHull(bodies, boat)

    def collides(self, eta: Floats) -> Bools:
        """Return whether the surface of the hull touches a surface of the harbor, (n, 3) to (n,)."""
        request = fcl.CollisionRequest()
        contacts = [
            fcl.collide(hull, self._solids, request, fcl.CollisionResult()) for hull in self._placed(eta)
        ]
        return np.array(contacts, dtype=np.int64) > 0

    def blocked(self, eta: Floats) -> Bools:
        """Return whether the hull touches the harbor or one is inside the other, (n, 3) to (n,)."""
        poses = np.atleast_2d(eta)
        contained = np.maximum(self._interior.part_at(poses), self._inside_hull.part_in(poses))
        return self.collides(poses) | (contained >= 0)

    def unreachable(self, eta: Floats, goal: Floats) -> Bools:
        """Return whether poses are blocked or not connected by water with the goal (3,), (n, 3) to (n,)."""
        region = self._waters.region(np.vstack([goal, eta]))
        return np.asarray((region[1:] != region[0]) | self.blocked(eta))

    @cached_property
    def _waters(self) -> Waters:
        return Waters(self.harbor.triangles, self.hull)

    def collided_part(self, eta: Floats) -> str | None:
        """Return the name of the part that blocks the pose (3,), or None."""
        (hull,) = self._placed(eta)
        result = fcl.CollisionResult()
        if fcl.collide(hull, self._solids, fcl.CollisionRequest(enable_contact=True), result):
            part = int(self.harbor.part_of_triangle[result.contacts[0].b2])
        else:
            pose = np.atleast_2d(eta)
            part = int(max(self._interior.part_at(pose)[0], self._inside_hull.part_in(pose)[0]))
        return self.harbor.parts[part].name if part >= 0 else None

    def clearance(self, eta: Floats) -> Floats:
        """Return the distance between the hull and the harbor, 0 in contact, (n, 3) to (n,) [m]."""
        request = fcl.DistanceRequest()
        gaps = [fcl.distance(hull, self._solids, request, fcl.DistanceResult()) for hull in self._placed(eta)]
        return np.maximum(np.array(gaps, dtype=np.float64), 0.0)

    def _placed(self, eta: Floats) -> Iterator[fcl.CollisionObject]:
        """Yield a hull at each pose; each call has its own hull, so that threads can share the checker."""
        hull = fcl.CollisionObject(self._hull)
        rotation = np.eye(3)
        for x, y, heading in np.atleast_2d(eta).tolist():
            cosine, sine = math.cos(heading), math.sin(heading)
            rotation[0, 0], rotation[0, 1], rotation[1, 0], rotation[1, 1] = cosine, -sine, sine, cosine
            hull.setTransform(fcl.Transform(rotation, (x, y, 0.0)))
            yield hull


@shared(lambda checker: SIZE_BY_TRIANGLES * checker.harbor.triangles.nbytes)
def collision_checker(harbor: Harbor, hull: Hull) -> CollisionChecker:
    """Return the checker of a hull in a harbor, from a cache."""
    return CollisionChecker(harbor, hull)


def hull_reach_m(hull: Hull) -> float:
    """Return the greatest horizontal distance of a point of the hull from the body origin [m]."""
    return float(np.hypot(*hull_mesh(hull).vertices[:, :2].T).max())


def least_clearance(eta: Floats, clearance: Callable[[Floats], Floats], reach_m: float) -> float:
    """Return the minimum clearance over the poses of a trajectory, computed at few of them.

    No point of the hull moves farther than the body origin plus the heading change times `reach_m`, so the
    clearance cannot change by more than that. A section of the trajectory is skipped if this bound shows that
    its clearance is not below the minimum found so far.

    Args:
        eta: (k, 3) successive poses, x, y [m] and heading [rad]; k >= 1.
        clearance: clearance of poses, (m, 3) to (m,) [m].
        reach_m: greatest distance of a point of the hull from the body origin [m].
    """

    @cache
    def at(row: int) -> float:
        return float(clearance(eta[row : row + 1])[0])

    moves = np.hypot(*np.diff(eta[:, :2], axis=0).T) + reach_m * np.abs(wrap(np.diff(eta[:, 2])))
    moved = np.concatenate([[0.0], np.cumsum(moves)])
    least = min(at(0), at(len(eta) - 1))
    sections = [(0, len(eta) - 1)]
    while sections:
        first, last = sections.pop()
        bound = (at(first) + at(last) - (moved[last] - moved[first])) / 2
        if last - first > 1 and bound < least:
            middle = (first + last) // 2
            least = min(least, at(middle))
            sections += [(first, middle), (middle, last)]
    return least


def _bvh(meshes: Sequence[trimesh.Trimesh]) -> fcl.BVHModel:
    """Build a bounding volume hierarchy over the triangles of the meshes, in their order."""
    model = fcl.BVHModel()
    model.beginModel(sum(len(mesh.faces) for mesh in meshes), sum(len(mesh.vertices) for mesh in meshes))
    for mesh in meshes:
        model.addSubModel(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    model.endModel()
    return model


Body = tuple[int, trimesh.Trimesh]


def _closed_bodies(harbor: Harbor) -> Iterator[Body]:
    """Yield part index and mesh of every watertight solid."""
    for index, part in enumerate(harbor.parts):
        for solid in part.solids:
            if solid.mesh.is_watertight:
                yield index, solid.mesh


class _Interior:
    """Finds the part that contains a point at the height `z`, by winding numbers in a cross-section."""

    def __init__(self, bodies: Sequence[Body], z: float) -> None:
        cuts = [cross_section(mesh.triangles, z) for _, mesh in bodies]
        self._segments = np.concatenate([np.empty((0, 2, 2)), *cuts])
        self._body = np.repeat(np.arange(len(cuts)), [len(cut) for cut in cuts])
        self._part_of_body = np.array([*(part for part, _ in bodies), -1])

    def part_at(self, eta: Floats) -> Ints:
        """Return the part that contains the origin of each pose, -1 for none, (n, 3) to (n,)."""
        return np.array([self._part_containing(x, y) for x, y, _ in eta], np.int64)

    def _part_containing(self, x: float, y: float) -> int:
        (x0, y0), (x1, y1) = np.moveaxis(self._segments, 0, -1)
        crossed = np.flatnonzero((y0 <= y) != (y1 <= y))  # half-open: a shared corner counts once
        x0, y0, x1, y1 = x0[crossed], y0[crossed], x1[crossed], y1[crossed]
        right = x0 + (y - y0) / (y1 - y0) * (x1 - x0) > x
        turns = np.bincount(self._body[crossed[right]], np.sign(y1 - y0)[right], minlength=1)
        return int(self._part_of_body[np.argmax(turns != 0) if turns.any() else -1])


class _InsideHull:
    """Finds the part inside the hull without contact: solids that are small enough, tested by one corner."""

    def __init__(self, bodies: Sequence[Body], hull: trimesh.Trimesh) -> None:
        reach = np.linalg.norm(hull.extents[:2])
        low, high = hull.bounds[:, 2]
        small = [
            (part, mesh.vertices[0])
            for part, mesh in bodies
            if mesh.bounds[0, 2] > low and mesh.bounds[1, 2] < high and mesh.extents[:2].max() < reach
        ]
        self._parts = np.array([part for part, _ in small], np.int64)
        self._points = np.array([point for _, point in small]).reshape(-1, 3)
        self._normals = hull.face_normals
        self._offsets = np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0])

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
