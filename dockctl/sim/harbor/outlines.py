"""Solids seen from above: the outlines that a drawing fills."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator

import numpy as np
import trimesh
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEAST_AREA_M2 = 0.002


def outlines(mesh: trimesh.Trimesh) -> Iterator[tuple[Floats, float]]:
    """Yield each outline (k, 2) counter-clockwise, with the height of its highest corner [m].

    An outline is a loop of edges between a triangle that faces up and one that does not; loops around holes
    run clockwise and are left out, as are loops that enclose almost nothing.
    """
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    up = mesh.faces[_cross(b - a, c - a) > 1e-9]
    for loop in _loops(up):
        corners = mesh.vertices[loop]
        xy = np.asarray(corners[:, :2])
        if _cross(xy, np.roll(xy, -1, axis=0)).sum() / 2 > LEAST_AREA_M2:
            yield xy, float(corners[:, 2].max())


def _loops(faces: NDArray[np.int64]) -> Iterator[list[int]]:
    """Chain the directed edges that only one of the triangles has into closed loops of vertices."""
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


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
