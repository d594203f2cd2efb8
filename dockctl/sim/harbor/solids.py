"""Closed solids from rings of points: every shape of the harbor is a loft."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Points = Floats | Sequence[Sequence[float] | Floats]
"""A row of points, (k, 3) or (k, 2)."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A closed mesh [m] and what a drawing calls it: one of `dockctl.drawing.scene.KINDS`."""

    kind: str
    mesh: trimesh.Trimesh

    def shifted(self, by: Sequence[float]) -> Solid:
        """Return the solid moved by (x, y, z) [m]."""
        vertices = self.mesh.vertices + np.asarray(by)
        return Solid(self.kind, trimesh.Trimesh(vertices, self.mesh.faces, process=False))


def joined(solids: Iterable[Solid]) -> trimesh.Trimesh:
    """Return all solids in one mesh; vertices are not merged, so that each solid remains closed."""
    meshes = [solid.mesh for solid in solids]
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=False)]
    return trimesh.Trimesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces), process=False)


def loft(rings: ArrayLike) -> trimesh.Trimesh:
    """Skin (s, k, 3) rings one after the other and cap both ends; the result is closed and faces outwards.

    A cap zigzags between the points i and k - i of its ring, which is right for every convex ring
    and for every ring that is symmetric about the line through its points 0 and k / 2 and monotone along it.
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


def outward(vertices: Floats, faces: NDArray[np.int64]) -> trimesh.Trimesh:
    """Make a mesh of closed, consistently wound triangles, turned inside out if its volume is negative."""
    a, b, c = np.moveaxis(vertices[faces] - vertices[0], 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c))
    return trimesh.Trimesh(vertices, faces if volume > 0 else faces[:, ::-1], process=False)


def box(low: Sequence[float], high: Sequence[float]) -> trimesh.Trimesh:
    """Return the box between two corners (x, y, z)."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    return prism([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], z0, z1)


def prism(outline: Points, z0: float, z1: float) -> trimesh.Trimesh:
    """Return a (k, 2) outline, convex or symmetric as `loft` says, between two heights."""
    xy = np.asarray(outline, dtype=np.float64)
    return loft([np.column_stack((xy, np.full(len(xy), z))) for z in (z0, z1)])


def tube(path: Points, radius: ArrayLike, sides: int = 6) -> trimesh.Trimesh:
    """Return a round bar along a (p, 3) path; `radius` is one number or one for each point [m]."""
    points = np.asarray(path, dtype=np.float64)
    radii = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(points))
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    angles = (np.arange(sides) + 0.5) * (2 * np.pi / sides)
    normal = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    rings = []
    for point, tangent, r in zip(points, tangents, radii, strict=True):
        normal = normal - (normal @ tangent) * tangent  # carried along, so that the rings do not twist
        normal /= np.linalg.norm(normal)
        across = np.cross(tangent, normal)
        rings.append(point + r * (np.outer(np.cos(angles), normal) + np.outer(np.sin(angles), across)))
    return loft(rings)


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
