"""Strokes of the plan view of a scene, in painting order, for figures and for frames of the environment."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dockctl.drawing import palette
from dockctl.drawing.scene import Polygon, Scene

Floats = NDArray[np.float64]
SHADED = ("quay", "finger", "hull", "tube", "mesh")
SHADOW_M_PER_M = np.array([0.16, -0.22])  # offset of the shadow per meter of height
PLANK_M = 0.5
OPEN_WATER_M = 15.0


@dataclass(frozen=True)
class Stroke:
    """A polygon, or a line if `fill` is None, and the width of its outline [m]."""

    xy: Floats
    fill: str | None
    edge: str | None
    width_m: float = 0.04


def strokes(scene: Scene) -> Iterator[Stroke]:
    """Yield the strokes of a scene: shadows on the water, then the polygons in their order."""
    for polygon in scene.polygons:
        if polygon.kind in SHADED:
            yield Stroke(polygon.xy + min(polygon.height_m, 2.0) * SHADOW_M_PER_M, palette.WATER_SHADE, None)
    for polygon in scene.polygons:
        edge = palette.EDGE.get(polygon.kind, palette.EDGE["mesh"])
        yield Stroke(polygon.xy, palette.solid_color(polygon.kind, polygon.name), edge)
        if polygon.kind == "finger" and len(polygon.xy) == 4:
            yield from _planks(polygon)


def _planks(polygon: Polygon) -> Iterator[Stroke]:
    """Yield lines across a finger pier, between its two long edges."""
    along, across = (np.linalg.norm(polygon.xy[i + 1] - polygon.xy[i]) for i in (0, 1))
    a, b, c, d = polygon.xy if along > across else np.roll(polygon.xy, -1, axis=0)
    count = int(np.linalg.norm(b - a) / PLANK_M)
    for part in np.arange(1, count) / max(count, 1):
        yield Stroke(np.array([a + part * (b - a), d + part * (c - d)]), None, palette.PLANK, 0.03)


def water(scene: Scene) -> tuple[float, float, float, float]:
    """Return the rectangle of water to show [m]: the basin, or open water around a harbor without quays."""
    if any(polygon.kind == "quay" for polygon in scene.polygons):
        return scene.bounds
    x_min, y_min, x_max, y_max = scene.bounds
    return x_min - OPEN_WATER_M, y_min - OPEN_WATER_M, x_max + OPEN_WATER_M, y_max + OPEN_WATER_M
