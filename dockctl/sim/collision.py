"""Exact contact and clearance between the boat and the harbor, computed with python-fcl."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property, lru_cache
from threading import Lock
from typing import TYPE_CHECKING, Any, ClassVar, Protocol
from weakref import WeakSet

import fcl
import numpy as np

from dockctl.compute import shared
from dockctl.geometry import Bools, Floats, Ints
from dockctl.scenarios.vessel import Hull
from dockctl.sim.containment import InsideHull, Interior
from dockctl.sim.harbor.build import Harbor
from dockctl.sim.harbor.solids import hull_mesh
from dockctl.sim.harbor.waters import Waters

if TYPE_CHECKING:
    from dockctl.sim.harbor.distances import DistanceField

SIZE_BY_TRIANGLES = 8
"""Memory of a checker, relative to the harbor's triangle array; measured on the reference marina."""
KEPT_TRIANGLES = 350_000
"""Maximum number of triangles kept as fcl objects, in all harbors together; about 490 bytes each."""
MAX_BOXES = 128
"""Maximum number of cached bounding boxes of hulls with a margin."""
SLACK_M = 1e-3
"""Greater than the rounding errors of fcl's distance between convex shapes."""


class Obstacles(Protocol):
    """What a boat can collide with. Poses `eta` are (n, 3) x, y [m] and heading [rad]."""

    def near(self, eta: Floats, within_m: float) -> Bools:
        """Return whether the hull can touch something if its points move at most this far, (n,)."""
        ...

    def blocked(self, eta: Floats) -> Bools:
        """Return whether the hull touches or is inside something, (n,)."""
        ...

    def unreachable(self, eta: Floats, goal: Floats) -> Bools:
        """Return whether poses are blocked or not connected to the goal (3,) by water, (n,)."""
        ...

    def collided_part(self, eta: Floats) -> str | None:
        """Return the name of what the hull touches at one pose (3,)."""
        ...

    def clearance(self, eta: Floats) -> Floats:
        """Return the distance (n,) [m] between the hull and the nearest obstacle."""
        ...

    def clearance_below(self, eta: Floats, limit_m: float) -> Floats:
        """Return `clearance` where it is less than `limit_m`, else `limit_m`, (n,) [m]."""
        ...

    def approximate_clearance(self, eta: Floats) -> Floats:
        """Return about `clearance`, of many poses, fast, (..., 3) to (...) [m]; see `DistanceField`."""
        ...


class CollisionChecker:
    """The hull of one boat in one harbor; poses are rows x, y [m], heading [rad].

    fcl compares surfaces and reports no contact for a boat inside a quay or a buoy inside the boat; `blocked`
    detects these cases, too. An open mesh has no inside.
    """

    def __init__(self, harbor: Harbor, hull: Hull) -> None:
        self.harbor, self.hull = harbor, hull
        boat = hull_mesh(hull)
        self._size, self._middle = boat.extents, (hull.freeboard_m - hull.draft_m) / 2
        self._hull = _Shape(_bvh(boat.triangles))
        low, high = (getattr(harbor.triangles[:, :, 2], end)(axis=1) for end in ("min", "max"))
        margin = 2 * SLACK_M
        touchable = (low <= hull.freeboard_m + margin) & (high >= -hull.draft_m - margin)
        # Two thirds of a marina (rigs, cabins, decks) cannot touch the hull; only clearances need them.
        self._low, self._high = _Surfaces(harbor, touchable), _Surfaces(harbor, ~touchable)
        bodies = [(index, solid.mesh) for index, part in enumerate(harbor.parts) for solid in part.solids]
        self._interior = Interior(bodies, self._middle)
        self._inside_hull = InsideHull(bodies, boat)

    def near(self, eta: Floats, within_m: float) -> Bools:
        """Return whether the hull can touch a surface if each of its points moves at most this far.

        Conservative: the hull's bounding box, enlarged by `within_m`, is tested. If it is False, nothing can
        enter the hull, and the hull can neither enter nor leave anything.

        Args:
            eta: (n, 3) poses.
            within_m: maximum displacement of a point of the hull [m].
        """
        length, beam, height = (self._size + 2 * SLACK_M).tolist()
        box = _box(length + 2 * within_m, beam + 2 * within_m, height)
        return self._touching(box, eta, within_m, self._middle)

    def collides(self, eta: Floats) -> Bools:
        """Return whether the surface of the hull touches a surface of the harbor, (n, 3) to (n,)."""
        return self._touching(self._hull, eta)

    def blocked(self, eta: Floats) -> Bools:
        """Return whether the hull touches the harbor or one is inside the other, (n, 3) to (n,)."""
        return self.collides(eta) | (self._contained(eta) >= 0)

    def unreachable(self, eta: Floats, goal: Floats) -> Bools:
        """Return whether poses are blocked or not connected to the goal (3,) by water, (n, 3) to (n,)."""
        region = self._waters.region(np.vstack([goal, eta]))
        return np.asarray((region[1:] != region[0]) | self.blocked(eta))

    @cached_property
    def _waters(self) -> Waters:
        return Waters(self.harbor.triangles, self.hull)

    def collided_part(self, eta: Floats) -> str | None:
        """Return the name of the part that blocks the pose (3,), or None."""
        pose = eta[None]
        close = np.flatnonzero(self._low.overlaps(self._bounds(pose))[0]).tolist()
        touched = (
            part
            for hull in self._hull.placed(pose)
            for part in close
            if _touch(hull, self._low.of_part(part))
        )
        part = next(touched, -1)
        if part < 0:
            part = int(self._contained(pose)[0])
        return self.harbor.parts[part].name if part >= 0 else None

    def clearance(self, eta: Floats) -> Floats:
        """Return the distance between the hull and the harbor, 0 if it is blocked, (n, 3) to (n,) [m]."""
        return self.clearance_below(eta, np.inf)

    def approximate_clearance(self, eta: Floats) -> Floats:
        """Return about `clearance`, of many poses, fast, (..., 3) to (...) [m]; see `DistanceField`."""
        return self._distances.clearance(eta)

    @cached_property
    def _distances(self) -> DistanceField:
        from dockctl.sim.harbor.distances import DistanceField  # compiles on import

        return DistanceField(self.harbor.triangles, self.hull)

    def clearance_below(self, eta: Floats, limit_m: float) -> Floats:
        """Return `clearance` where it is less than `limit_m`, else `limit_m`, (n, 3) to (n,) [m].

        Much faster than `clearance` for poses in open water.
        """
        request, bounds = fcl.DistanceRequest(), self._bounds(eta)
        low, high = self._low.gaps(bounds), self._high.gaps(bounds)
        result = np.full(len(eta), limit_m)
        for row, hull in enumerate(self._hull.placed(eta)):
            gaps = np.concatenate([low[row], high[row]])
            for number in np.argsort(gaps).tolist():
                if gaps[number] - SLACK_M >= result[row]:
                    break
                surfaces = self._low if number < len(low[row]) else self._high
                solid = surfaces.of_part(number % len(low[row]))
                distance = fcl.distance(hull, solid, request, fcl.DistanceResult())
                result[row] = min(result[row], max(distance, 0.0))
        result[self._contained(eta) >= 0] = 0.0
        return result

    def _contained(self, eta: Floats) -> Ints:
        """Return the part that contains the hull or is inside it, -1 for none, (n, 3) to (n,)."""
        return np.maximum(self._interior.part_at(eta), self._inside_hull.part_in(eta))

    def _bounds(self, eta: Floats, margin_m: float = 0.0) -> Floats:
        """Return x_min, y_min, x_max, y_max (n, 4) [m] of the hull, enlarged on all sides."""
        length, beam, _ = self._size / 2 + SLACK_M + margin_m
        cosine, sine = np.abs(np.cos(eta[:, 2])), np.abs(np.sin(eta[:, 2]))
        reach = np.array([length * cosine + beam * sine, length * sine + beam * cosine]).T
        return np.concatenate([eta[:, :2] - reach, eta[:, :2] + reach], axis=1)

    def _touching(self, shape: _Shape, eta: Floats, margin_m: float = 0.0, z: float = 0.0) -> Bools:
        """Return whether the hull, or its box with a margin, touches anything between keel and deck."""
        close = self._low.overlaps(self._bounds(eta, margin_m))
        (rows,), touching = np.nonzero(close.any(axis=1)), np.zeros(len(eta), bool)
        for row, boat in zip(rows.tolist(), shape.placed(eta[rows], z), strict=True):
            (parts,) = np.nonzero(close[row])
            touching[row] = any(_touch(boat, self._low.of_part(part)) for part in parts.tolist())
        return touching


class _Surfaces:
    """Some of the triangles of a harbor, as one fcl object for each part, built when needed.

    fcl takes ten times the memory of the triangles, and a boat comes near few parts of a harbor. In training
    in many harbors, however, all parts are needed: once `KEPT_TRIANGLES` have been built, all are dropped.
    """

    _all: ClassVar[WeakSet[_Surfaces]] = WeakSet()
    _built: ClassVar[int] = 0
    _lock: ClassVar[Lock] = Lock()

    def __init__(self, harbor: Harbor, chosen: Bools) -> None:
        numbers = np.flatnonzero(chosen)
        numbers = numbers[np.argsort(harbor.part_of_triangle[numbers], kind="stable")]
        ends = np.searchsorted(harbor.part_of_triangle[numbers], np.arange(1, len(harbor.parts)))
        self._triangles, self._numbers = harbor.triangles, np.split(numbers, ends)
        self._objects: dict[int, fcl.CollisionObject] = {}
        corners = [harbor.triangles[own, :, :2].reshape(-1, 2) for own in self._numbers]
        self._low = np.array([each.min(axis=0, initial=np.inf) for each in corners])
        self._high = np.array([each.max(axis=0, initial=-np.inf) for each in corners])
        with self._lock:
            self._all.add(self)

    def gaps(self, bounds: Floats) -> Floats:
        """Return the horizontal distance between boxes and the bounds of each part, (n, 4) to (n, parts) [m].

        The distance is 0 where they overlap, and infinite for a part without triangles.
        """
        below = self._low - bounds[:, None, 2:]
        above = bounds[:, None, :2] - self._high
        gap = np.maximum(np.maximum(below, above), 0.0)
        gaps: Floats = np.hypot(gap[:, :, 0], gap[:, :, 1])
        return gaps

    @property
    def bounds(self) -> Floats:
        """Smallest and largest x, y of each part, (parts, 4) [m]."""
        return np.hstack([self._low, self._high])

    def overlaps(self, bounds: Floats) -> Bools:
        """Return where `gaps` is 0, (n, 4) to (n, parts)."""
        x0, y0, x1, y1 = bounds.T[:, :, None]
        (low_x, low_y), (high_x, high_y) = self._low.T, self._high.T
        overlapping: Bools = (low_x <= x1) & (x0 <= high_x) & (low_y <= y1) & (y0 <= high_y)
        return overlapping

    def of_part(self, part: int) -> fcl.CollisionObject:
        """Return the surface of a part."""
        found = self._objects.get(part)
        if found is None:
            numbers = self._numbers[part]
            found = fcl.CollisionObject(_bvh(self._triangles[numbers]))
            with self._lock:
                _Surfaces._built += len(numbers)
                if self._built > KEPT_TRIANGLES:
                    _Surfaces._built = len(numbers)
                    for surfaces in self._all:
                        surfaces._objects.clear()
                self._objects[part] = found
        return found


def _touch(one: fcl.CollisionObject, other: fcl.CollisionObject) -> bool:
    return bool(fcl.collide(one, other, fcl.CollisionRequest(), fcl.CollisionResult()))


class _Shape:
    """A shape and its fcl objects, which are reused: python-fcl leaks 32 bytes per object."""

    def __init__(self, geometry: Any) -> None:
        self._geometry, self._idle = geometry, list[fcl.CollisionObject]()

    def placed(self, eta: Floats, z: float = 0.0) -> Iterator[fcl.CollisionObject]:
        """Yield the shape at each pose; each call uses its own object, so threads can share a checker."""
        try:
            boat = self._idle.pop()
        except IndexError:
            boat = fcl.CollisionObject(self._geometry)
        try:
            rotation = np.eye(3)
            for x, y, heading in eta.tolist():
                cosine, sine = math.cos(heading), math.sin(heading)
                rotation[0, 0], rotation[0, 1], rotation[1, 0], rotation[1, 1] = cosine, -sine, sine, cosine
                boat.setTransform(fcl.Transform(rotation, (x, y, z)))
                yield boat
        finally:
            self._idle.append(boat)


@lru_cache(maxsize=MAX_BOXES)
def _box(length: float, beam: float, height: float) -> _Shape:
    return _Shape(fcl.Box(length, beam, height))


@shared(lambda checker: SIZE_BY_TRIANGLES * checker.harbor.triangles.nbytes)
def collision_checker(harbor: Harbor, hull: Hull) -> CollisionChecker:
    """Return the checker of a hull in a harbor, from a cache."""
    return CollisionChecker(harbor, hull)


def overlapping_vessels(harbor: Harbor) -> list[tuple[str, str]]:
    """Return the names of each moored vessel and of a part that its surface touches."""
    surfaces = _Surfaces(harbor, np.ones(len(harbor.triangles), bool))
    near, is_vessel = surfaces.overlaps(surfaces.bounds), [part.kind == "vessel" for part in harbor.parts]
    pairs = (
        (one, other)
        for one, other in np.argwhere(near).tolist()
        if is_vessel[one] and one != other and (one < other or not is_vessel[other])
    )
    return [
        (harbor.parts[one].name, harbor.parts[other].name)
        for one, other in pairs
        if _touch(surfaces.of_part(one), surfaces.of_part(other))
    ]


def _bvh(triangles: Floats) -> fcl.BVHModel:
    """Build a bounding volume hierarchy over triangles (m, 3, 3), in their order."""
    model = fcl.BVHModel()
    model.beginModel(len(triangles), 3 * len(triangles))
    model.addSubModel(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    model.endModel()
    return model
