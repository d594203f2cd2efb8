"""Builds fishing-harbor.glb, which stands in for a harbor modeled in Blender or SketchUp or from a survey.

python examples/glb-harbor/build.py
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh

FILE = Path(__file__).with_name("fishing-harbor.glb")
Y_UP = trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])  # from z up to y up, as in GLB files


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    """Return an axis-parallel box between two corners [m]."""
    return trimesh.creation.box(bounds=[low, high])


def solids() -> Iterator[tuple[str, trimesh.Trimesh]]:
    """Yield the closed solids of the harbor by name: meters, z up, water at z = 0."""
    yield "quay", box((-16, 12, -2), (16, 16, 1.2))
    yield "west mole", box((-15.9, -20, -2), (-13, 14, 1.5))
    yield "east mole", box((13, -6, -2), (15.9, 14, 1.5))
    yield "south mole", box((-16, -21, -2), (8, -18, 1.5))
    yield "west jetty", box((-4, 4, -0.5), (-3, 12, 0.5))
    yield "east jetty", box((4, 4, -0.5), (5, 12, 0.5))
    for x in (-3.5, 4.5):
        for y in (4.5, 8):
            pile = trimesh.creation.cylinder(radius=0.15, height=5, sections=10)
            yield f"pile {x:g} {y:g}", pile.apply_translation([x, y, 0.5])
    hull = trimesh.convex.convex_hull(
        [[x, y, z] for x, z in ((-1, -0.5), (1, -0.5), (-1.3, 1.1), (1.3, 1.1)) for y in (-3, 2)]
        + [[0, -4.5, 1.5], [0, -3.6, -0.4]]
    )
    for number, x in enumerate((-6.5, 8)):
        yield f"fishing boat {number}", hull.copy().apply_translation([x, 8.5, 0])
        yield f"wheelhouse {number}", box((x - 0.8, 8, 1), (x + 0.8, 10, 3))


if __name__ == "__main__":
    scene = trimesh.Scene({name: solid.apply_transform(Y_UP) for name, solid in solids()})
    FILE.write_bytes(scene.export(file_type="glb"))
    print(FILE)
