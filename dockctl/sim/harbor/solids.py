"""Closed solids, lofted from rings of points: basic shapes, our boat's hull, and outlines from above."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Hull

PartKind = Literal["quay", "finger", "pile", "vessel", "mesh"]
Points = Floats | Sequence[Sequence[float] | Floats]
"""Points, (k, 3) or (k, 2)."""

BOW_SHARE = 0.35
"""Fraction of the length over which the bow narrows."""
BOW_BREADTHS = ((0.0, 1.0), (0.35, 0.9), (0.65, 0.66), (0.88, 0.32), (1.0, 0.06))
"""Half-breadths along the bow: (fraction of the distance to the stem, fraction of half the beam)."""
MIN_OUTLINE_M2 = 0.002
"""Outlines with a smaller area are not drawn."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh: vertices (k, 3) [m] and faces (m, 3)."""

    # Not trimesh's class: importing trimesh takes most of a second, and only reading mesh files needs it.

    vertices: Floats
    faces: NDArray[np.int64]

    @property
    def triangles(self) -> Floats:
        """The corners of the triangles, (m, 3, 3) [m]."""
        return self.vertices[self.faces]

    @cached_property
    def bounds(self) -> Floats:
        """The lower and the upper corner of the bounding box, (2, 3) [m]."""
        return np.array([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extents(self) -> Floats:
        """The size of the bounding box, (3,) [m]."""
        return np.asarray(self.bounds[1] - self.bounds[0], np.float64)

    @property
    def normals(self) -> Floats:
        """Unit normals of the triangles, (m, 3)."""
        a, b, c = np.moveaxis(self.triangles, 1, 0)
        across = np.cross(b - a, c - a)
        return np.asarray(across / np.linalg.norm(across, axis=1, keepdims=True), np.float64)

    @cached_property
    def is_watertight(self) -> bool:
        """Whether every edge belongs to exactly two triangles."""
        edges = np.sort(self.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        _, counts = np.unique(edges @ [len(self.vertices), 1], return_counts=True)
        return bool((counts == 2).all())


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed mesh [m] and its kind for drawings, one of `dockctl.drawing.palette.SOLIDS`."""

    kind: str
    mesh: Mesh

    def shifted(self, by: Sequence[float]) -> Solid:
        """Return the solid moved by (x, y, z) [m]."""
        vertices = self.mesh.vertices + np.asarray(by)
        return Solid(self.kind, Mesh(vertices, self.mesh.faces))


def joined(solids: Iterable[Solid]) -> Mesh:
    """Return all solids in one mesh; vertices are not merged, so that each solid remains closed."""
    meshes = [solid.mesh for solid in solids]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


@dataclass(frozen=True, eq=False)
class Part:
    """One obstacle; `solids` are its closed solids in the world frame [m]."""

    name: str
    kind: PartKind
    solids: tuple[Solid, ...]

    @property
    def mesh(self) -> Mesh:
        """All solids in one mesh."""
        return joined(self.solids)


def loft(rings: ArrayLike) -> Mesh:
    """Return the closed, outward-facing solid with (s, k, 3) successive rings as its cross-sections.

    The caps connect the points i and k - i of a ring in a zigzag. This is valid for convex rings and for
    rings that are symmetric about the line through their points 0 and k / 2 and monotone along it.
    """
    points = np.asarray(rings, dtype=np.float64)
    s, k, _ = points.shape
    index = np.arange(s * k).reshape(s, k)
    a, b = index[:-1], np.roll(index, -1, axis=1)[:-1]
    c, d = index[1:], np.roll(index, -1, axis=1)[1:]
    skin = np.stack((a, b, d, a, d, c), axis=-1).reshape(-1, 3)
    cap = _cap(k)
    faces = np.concatenate((skin, cap[:, ::-1], cap + (s - 1) * k))
    return outward(points.reshape(-1, 3), faces)


def outward(vertices: Floats, faces: NDArray[np.int64]) -> Mesh:
    """Return the mesh of closed, consistently wound triangles, flipped if its volume is negative.

    Args:
        vertices: (k, 3) [m].
        faces: (m, 3).
    """
    a, b, c = np.moveaxis(vertices[faces] - vertices[0], 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c))
    return Mesh(vertices, np.ascontiguousarray(faces if volume > 0 else faces[:, ::-1]))


def box(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """Return the box between two corners (x, y, z)."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return prism([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z0, z1)


def prism(outline: Points, z0: float, z1: float) -> Mesh:
    """Return the prism over a (k, 2) outline, convex or symmetric as in `loft`, between two heights."""
    xy = np.asarray(outline, dtype=np.float64)
    return loft([np.column_stack((xy, np.full(len(xy), z))) for z in (z0, z1)])


def tube(path: Points, radius: ArrayLike, sides: int = 6) -> Mesh:
    """Return a round bar along a (p, 3) path with one radius, or one per point [m]."""
    points = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(points))
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    angles = (np.arange(sides) + 0.5) * (2 * np.pi / sides)
    normal = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    rings = []
    for point, tangent, r in zip(points, tangents, radii, strict=True):
        normal = normal - (normal @ tangent) * tangent  # parallel transport: the rings do not twist
        normal /= np.linalg.norm(normal)
        across = np.cross(tangent, normal)
        rings.append(point + r * (np.outer(np.cos(angles), normal) + np.outer(np.sin(angles), across)))
    return loft(rings)


def hull_outline(hull: Hull) -> Floats:
    """Return the convex (k, 2) outline of the hull from above, in the body frame, counterclockwise [m]."""
    stern, shoulder = -hull.length_m / 2, hull.length_m * (0.5 - BOW_SHARE)
    bow = [(shoulder + s * BOW_SHARE * hull.length_m, b * hull.beam_m / 2) for s, b in BOW_BREADTHS]
    port = [*reversed(bow), (stern, hull.beam_m / 2)]
    starboard = [(x, -y) for x, y in reversed(port)]
    return np.array(port + starboard)


def hull_mesh(hull: Hull) -> Mesh:
    """Return the convex, closed hull in the body frame: water at z = 0, keel at -draft [m]."""
    outline = hull_outline(hull)
    return loft([np.insert(outline, 2, z, axis=1) for z in (-hull.draft_m, hull.freeboard_m)])


def outlines(mesh: Mesh) -> Iterator[tuple[Floats, float]]:
    """Yield the outlines (k, 2) from above, counterclockwise, with the heights of their highest corners [m].

    An outline is a loop of edges between a triangle that faces up and one that does not. Loops around holes
    run clockwise and are skipped, as are loops with almost no area.
    """
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    up = mesh.faces[_cross2(b - a, c - a) > 1e-9]
    for loop in _loops(up):
        corners = mesh.vertices[loop]
        xy = np.asarray(corners[:, :2])
        if _cross2(xy, np.roll(xy, -1, axis=0)).sum() / 2 > MIN_OUTLINE_M2:
            yield xy, float(corners[:, 2].max())


def _cap(k: int) -> NDArray[np.int64]:
    """Triangulate a ring of k points by a zigzag 0, 1, k-1, 2, k-2, ..., (k - 2, 3)."""
    half = np.arange(1, k)
    strip = np.empty(k, dtype=np.int64)
    strip[0] = 0
    strip[1::2] = half[: len(strip[1::2])]
    strip[2::2] = half[::-1][: len(strip[2::2])]
    triangles = np.stack((strip[:-2], strip[1:-1], strip[2:]), axis=1)
    triangles[1::2] = triangles[1::2, ::-1]
    return triangles


def _loops(faces: NDArray[np.int64]) -> Iterator[list[int]]:
    """Yield the closed loops of directed edges that belong to only one of the triangles."""
    edges = set(map(tuple, np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]])).tolist()))
    following = defaultdict(list)
    for start, end in sorted(edges):
        if (end, start) not in edges:
            following[start].append(end)
    for start in sorted(following):
        while following[start]:
            loop = [start]
            while following[loop[-1]]:
                loop.append(following[loop[-1]].pop())
            yield loop[:-1]


def _cross2(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
