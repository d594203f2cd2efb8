"""The harbor and the boat in plan view: plain data for drawings, and their strokes in painting order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from dockctl.drawing import palette
from dockctl.geometry import Floats

SHADED = ("quay", "finger", "hull", "tube", "mesh")
SHADOW_M_PER_M = np.array([0.16, -0.22])  # offset of the shadow per meter of height
PLANK_M = 0.5
OPEN_WATER_M = 15.0


@dataclass(frozen=True, eq=False)
class Polygon:
    """Outline of a solid from above, (k, 2) [m] without a closing point, and the height of its top [m]."""

    kind: str
    name: str
    xy: Floats
    height_m: float


@dataclass(frozen=True, eq=False)
class Scene:
    """A harbor and a boat in plan view; polygons are painted in their order.

    Attributes:
        name: name of the harbor.
        polygons: outlines in the world frame [m].
        hull: (k, 2) outline of our boat in the body frame [m].
        bounds: bounds of the water, ``(x_min, y_min, x_max, y_max)`` [m].
    """

    name: str
    polygons: tuple[Polygon, ...]
    hull: Floats
    bounds: tuple[float, float, float, float]

    def to_json(self) -> dict[str, Any]:
        """Return the scene as JSON data, rounded to millimeters."""
        return {
            "name": self.name,
            "bounds_m": _rounded(self.bounds),
            "hull_m": _rounded(self.hull),
            "polygons": [
                {"kind": p.kind, "name": p.name, "height_m": round(p.height_m, 3), "xy_m": _rounded(p.xy)}
                for p in self.polygons
            ],
        }

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        """Return the scene from the data of `to_json`.

        Raises:
            KeyError, TypeError, ValueError: the data is not a scene.
        """
        x_min, y_min, x_max, y_max = map(float, data["bounds_m"])
        if not (x_min < x_max and y_min < y_max):
            raise ValueError(f"bounds_m {data['bounds_m']}: the minimum must be less than the maximum")
        return cls(
            name=str(data["name"]),
            polygons=tuple(_polygons(data["polygons"])),
            hull=_outline(data["hull_m"]),
            bounds=(x_min, y_min, x_max, y_max),
        )


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
        yield Stroke(polygon.xy, *palette.solid_colors(polygon.kind, polygon.name))
        if polygon.kind == "finger" and len(polygon.xy) == 4:
            yield from _planks(polygon)


def water(scene: Scene) -> tuple[float, float, float, float]:
    """Return the rectangle of water to show [m]: the basin, or open water around a harbor without quays."""
    if any(polygon.kind == "quay" for polygon in scene.polygons):
        return scene.bounds
    x_min, y_min, x_max, y_max = scene.bounds
    return x_min - OPEN_WATER_M, y_min - OPEN_WATER_M, x_max + OPEN_WATER_M, y_max + OPEN_WATER_M


def _planks(polygon: Polygon) -> Iterator[Stroke]:
    """Yield lines across a finger pier, between its two long edges."""
    along, across = (np.linalg.norm(polygon.xy[i + 1] - polygon.xy[i]) for i in (0, 1))
    a, b, c, d = polygon.xy if along > across else np.roll(polygon.xy, -1, axis=0)
    count = int(np.linalg.norm(b - a) / PLANK_M)
    for part in np.arange(1, count) / max(count, 1):
        yield Stroke(np.array([a + part * (b - a), d + part * (c - d)]), None, palette.PLANK, 0.03)


def _polygons(rows: Iterable[dict[str, Any]]) -> Iterator[Polygon]:
    for row in rows:
        kind, name = row["kind"], row["name"]
        if not (isinstance(kind, str) and isinstance(name, str)):
            raise TypeError("the kind and the name of a polygon must be strings")
        yield Polygon(kind, name, _outline(row["xy_m"]), float(row["height_m"]))


def _outline(points: ArrayLike) -> Floats:
    outline = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    if len(outline) < 3 or not np.isfinite(outline).all():
        raise ValueError("an outline needs at least three corners with finite coordinates")
    return outline


def _rounded(values: ArrayLike) -> Any:
    return np.round(np.asarray(values, dtype=np.float64), 3).tolist()
