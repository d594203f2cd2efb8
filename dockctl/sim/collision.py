"""Contact and clearance between the boat and the harbor, exact, by python-fcl."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cache, cached_property, lru_cache
from typing import Any

import fcl
import numpy as np

from dockctl.compute import shared
from dockctl.geometry import Bools, Floats, Ints
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.build import Harbor
from dockctl.sim.harbor.solids import Mesh, hull_mesh
from dockctl.sim.harbor.waters import Waters, cross_section

SIZE_BY_TRIANGLES = 8
"""Memory of a checker, relative to the array of the harbor's triangles; measured on the reference marina."""
MAX_CONTACTS = 1_000_000
"""More than a hull has with the surfaces that it touches."""
CONTACT_RESOLUTION_M = 0.002
"""Motion of the hull between the poses at which contact is tested."""
SLACK_M = 1e-3
"""Greater than the rounding errors of fcl's distance between convex shapes."""


class CollisionChecker:
    """The hull of one boat in one harbor; poses are rows x, y [m], heading [rad].

    fcl compares surfaces and reports no contact for a boat inside a quay or a buoy inside the boat; `blocked`
    detects these cases, too. An open mesh has no inside.
    """

    def __init__(self, harbor: Harbor, hull: Hull) -> None:
        self.harbor, self.hull = harbor, hull
        boat = hull_mesh(hull)
        self._size, self._middle = boat.extents, (hull.freeboard_m - hull.draft_m) / 2
        self._hull = _bvh(boat.triangles)
        low, high = (getattr(harbor.triangles[:, :, 2], end)(axis=1) for end in ("min", "max"))
        margin = 2 * SLACK_M
        touchable = (low <= hull.freeboard_m + margin) & (high >= -hull.draft_m - margin)
        self._low, self._others = np.flatnonzero(touchable), np.flatnonzero(~touchable)
        self._low_solids = _objects(harbor.triangles[self._low])
        bodies = [(index, solid.mesh) for index, part in enumerate(harbor.parts) for solid in part.solids]
        self._interior = _Interior([body for body in bodies if body[1].is_watertight], self._middle)
        self._inside_hull = _InsideHull(bodies, boat)

    def near(self, eta: Floats, within_m: float) -> Bools:
        """Return whether the hull can touch a surface if each of its points moves at most this far.

        Conservative: the hull's bounding box, enlarged by `within_m`, is tested. If the answer is no, nothing
        gets into the hull and the hull does not get into or out of anything.

        Args:
            eta: (n, 3) poses.
            within_m: greatest displacement of a point of the hull [m].
        """
        length, beam, height = self._size + 2 * SLACK_M
        box = fcl.Box(length + 2 * within_m, beam + 2 * within_m, height)
        return self._touching(box, eta, self._middle)

    def collides(self, eta: Floats) -> Bools:
        """Return whether the surface of the hull touches a surface of the harbor, (n, 3) to (n,)."""
        return self._touching(self._hull, eta)

    def blocked(self, eta: Floats) -> Bools:
        """Return whether the hull touches the harbor or one is inside the other, (n, 3) to (n,)."""
        return self.collides(eta) | (self._contained(eta) >= 0)

    def unreachable(self, eta: Floats, goal: Floats) -> Bools:
        """Return whether poses are blocked or not connected by water with the goal (3,), (n, 3) to (n,)."""
        region = self._waters.region(np.vstack([goal, eta]))
        return np.asarray((region[1:] != region[0]) | self.blocked(eta))

    @cached_property
    def _other_solids(self) -> list[fcl.CollisionObject]:
        """Two thirds of a marina: rigs, cabins and decks, which only clearances depend on."""
        return _objects(self.harbor.triangles[self._others])

    @cached_property
    def _waters(self) -> Waters:
        return Waters(self.harbor.triangles, self.hull)

    def collided_part(self, eta: Floats) -> str | None:
        """Return the name of the part that blocks the pose (3,), or None."""
        pose = eta[None]
        (hull,) = _placed(self._hull, pose)
        found = [part for solids in self._low_solids for part in _contacts(hull, solids, MAX_CONTACTS)]
        touched = set(self.harbor.part_of_triangle[self._low[found]].tolist())
        if len(touched) > 1:  # the first one in the order of a tree of all triangles
            first = _contacts(hull, _all_solids(self.harbor), 1)
            touched = set(self.harbor.part_of_triangle[first].tolist())
        part = touched.pop() if touched else int(self._contained(pose)[0])
        return self.harbor.parts[part].name if part >= 0 else None

    def clearance_below(self, eta: Floats, limit_m: float) -> Floats:
        """Return `clearance` where it is less than `limit_m`, else `limit_m`, (n, 3) to (n,) [m].

        Much faster than `clearance` for poses in open water: an enlarged box is tested first.
        """
        box = fcl.Box(*(self._size + 2 * (SLACK_M + limit_m)))
        solids = self._low_solids + self._other_solids  # an enlarged box also touches what is above the deck
        close = self._touching(box, eta, self._middle, solids) | (self._contained(eta) >= 0)
        result = np.full(len(eta), limit_m)
        result[close] = np.minimum(self.clearance(eta[close]), limit_m)
        return result

    def clearance(self, eta: Floats) -> Floats:
        """Return the distance between the hull and the harbor, 0 if it is blocked, (n, 3) to (n,) [m]."""
        request, hulls = fcl.DistanceRequest(), _placed(self._hull, eta)
        solids = self._low_solids + self._other_solids
        gaps = [
            min(fcl.distance(hull, some, request, fcl.DistanceResult()) for some in solids) for hull in hulls
        ]
        return np.where(self._contained(eta) >= 0, 0.0, np.maximum(np.array(gaps, dtype=np.float64), 0.0))

    def _contained(self, eta: Floats) -> Ints:
        """Return the part that contains the hull or is inside it, -1 for none, (n, 3) to (n,)."""
        return np.maximum(self._interior.part_at(eta), self._inside_hull.part_in(eta))

    def _touching(
        self, shape: Any, eta: Floats, z: float = 0.0, solids: Sequence[Any] | None = None
    ) -> Bools:
        """Return whether the shape touches the solids, by default those between keel and deck."""
        request, solids = fcl.CollisionRequest(), self._low_solids if solids is None else solids
        touching = [
            any(fcl.collide(boat, some, request, fcl.CollisionResult()) for some in solids)
            for boat in _placed(shape, eta, z)
        ]
        return np.array(touching, dtype=bool)


def _placed(shape: Any, eta: Floats, z: float = 0.0) -> Iterator[fcl.CollisionObject]:
    """Yield the shape at each pose; each call has its own object, so that threads can share a checker."""
    boat = fcl.CollisionObject(shape)
    rotation = np.eye(3)
    for x, y, heading in eta.tolist():
        cosine, sine = math.cos(heading), math.sin(heading)
        rotation[0, 0], rotation[0, 1], rotation[1, 0], rotation[1, 1] = cosine, -sine, sine, cosine
        boat.setTransform(fcl.Transform(rotation, (x, y, z)))
        yield boat


@shared(lambda checker: SIZE_BY_TRIANGLES * checker.harbor.triangles.nbytes)
def collision_checker(harbor: Harbor, hull: Hull) -> CollisionChecker:
    """Return the checker of a hull in a harbor, from a cache."""
    return CollisionChecker(harbor, hull)


def first_contact(
    path: Floats, near: Callable[[Floats, float], Bools], blocked: Callable[[Floats], Bools], hull: Hull
) -> Floats | None:
    """Return where the hull first touches something on its way along a path, or None.

    A section of the path is skipped if nothing is near the hull at its middle; others are halved, down to
    `CONTACT_RESOLUTION_M` or, for small hulls, a tenth of the beam or length. A hull therefore cannot cross a
    surface, and only contact on a shorter way is missed.

    Args:
        path: (k, 3 + m) successive poses and any m other columns, linear in between; k >= 1.
        near, blocked: as of a `CollisionChecker`.
        hull: the hull.

    Returns:
        the row of `path`, interpolated, at the contact.
    """
    moved = _moved(path, hull.reach_m)
    resolution = min(CONTACT_RESOLUTION_M, 0.1 * hull.beam_m, 0.1 * hull.length_m)
    sections = [(0.0, float(moved[-1]))]
    while sections:
        begin, end = sections.pop()
        middle = (begin + end) / 2
        at = np.array([np.interp(middle, moved, column) for column in path.T])
        if end - begin <= resolution:
            if blocked(at[None, :3])[0]:
                return at
        elif near(at[None, :3], end - middle)[0]:
            sections += [(middle, end), (begin, middle)]
    return None


def least_clearance(eta: Floats, clearance: Callable[[Floats], Floats], reach_m: float) -> float:
    """Return the minimum clearance over the poses of a trajectory, computed at few of them.

    The clearance cannot change by more than the hull moves. A section of the trajectory is skipped if this
    bound shows that its clearance is not below the minimum found so far.

    Args:
        eta: (k, 3) successive poses, x, y [m] and heading [rad]; k >= 1.
        clearance: clearance of poses, (m, 3) to (m,) [m].
        reach_m: greatest distance of a point of the hull from the body origin [m].
    """

    @cache
    def at(row: int) -> float:
        return float(clearance(eta[row : row + 1])[0])

    moved = _moved(eta, reach_m)
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


def _moved(path: Floats, reach_m: float) -> Floats:
    """Return a bound of the way of any point of the hull up to each pose of a path, (k, 3 + m) to (k,) [m].

    No point moves farther than the body origin plus the heading change times `reach_m`.
    """
    x, y, heading = np.diff(path[:, :3], axis=0).T
    return np.concatenate([[0.0], np.cumsum(np.hypot(x, y) + reach_m * np.abs(heading))])


def _contacts(hull: fcl.CollisionObject, solids: fcl.CollisionObject, count: int) -> Ints:
    """Return the triangles of the solids in the first contacts, at most `count`."""
    request = fcl.CollisionRequest(num_max_contacts=count, enable_contact=True)
    result = fcl.CollisionResult()
    fcl.collide(hull, solids, request, result)
    return np.array([contact.b2 for contact in result.contacts], np.int64)


def _objects(triangles: Floats) -> list[fcl.CollisionObject]:
    """Return the triangles in one object, or none: fcl has no empty objects."""
    return [fcl.CollisionObject(_bvh(triangles))] if len(triangles) else []


@lru_cache(maxsize=4)
def _all_solids(harbor: Harbor) -> fcl.CollisionObject:
    return fcl.CollisionObject(_bvh(harbor.triangles))


def _bvh(triangles: Floats) -> fcl.BVHModel:
    """Build a bounding volume hierarchy over triangles (m, 3, 3), in their order."""
    model = fcl.BVHModel()
    model.beginModel(len(triangles), 3 * len(triangles))
    model.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    model.endModel()
    return model


Body = tuple[int, Mesh]


class _Interior:
    """Finds the part that contains a point at the height `z`, by winding numbers in a cross-section."""

    def __init__(self, bodies: Sequence[Body], z: float) -> None:
        triangles = np.concatenate([np.empty((0, 3, 3)), *(mesh.triangles for _, mesh in bodies)])
        body = np.repeat(np.arange(len(bodies)), [len(mesh.faces) for _, mesh in bodies])
        self._segments, cut = cross_section(triangles, z)
        self._body = body[cut]
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
