"""Minimal 3-D drawing: solids as seen by a pinhole camera (thesis Fig. 3.6)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from dockctl.drawing import palette
from dockctl.geometry import Floats

SUN = np.array([-0.45, -0.35, 0.82]) / np.linalg.norm([-0.45, -0.35, 0.82])
NEAR_M = 1.0
"""Minimum depth that is drawn."""


@dataclass(frozen=True, eq=False)
class Body:
    """A solid: name, kind for the color, and (m, 3, 3) triangles [m] with outward normals."""

    name: str
    kind: str
    triangles: Floats

    @property
    def color(self) -> str:
        return palette.solid_colors(self.kind, self.name)[0]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera at `eye` that looks at `target`, both (x, y, z) [m]."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]

    @cached_property
    def axes(self) -> Floats:
        """Unit vectors right, up and forward as rows, (3, 3)."""
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Return image coordinates (..., 2) and depths (...) [m] of points (..., 3) [m]."""
        seen = (points - np.asarray(self.eye)) @ self.axes.T
        depth = np.maximum(seen[..., 2], NEAR_M)
        return seen[..., :2] / depth[..., None], seen[..., 2]


def draw_bodies(ax: Axes, camera: Camera, bodies: Sequence[Body], *, shadows: bool = True) -> None:
    """Draw solids and their shadows on the water, farthest first, without back faces."""
    above = [replace(body, triangles=_above_water(body.triangles)) for body in bodies]
    for body in above if shadows else ():
        if body.kind != "quay":
            _add_polygons(ax, camera.project(_shadow(body.triangles))[0], palette.WATER_SHADE, zorder=1.5)
    polygons, colors = [], []
    for body in _far_to_near(camera, above):
        a, b, c = np.moveaxis(body.triangles, 1, 0)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1)
        shown = (length > 0) & (np.einsum("ij,ij->i", normal, np.asarray(camera.eye) - a) > 0)
        flat, depth = camera.project(body.triangles[shown])
        light = 0.6 + 0.4 * np.clip(normal[shown] @ SUN / length[shown], 0, 1)
        order = np.argsort(-depth.mean(axis=1), kind="stable")
        order = order[(depth[order] > NEAR_M).all(axis=1)]
        polygons.append(flat[order])
        colors.append(light[order, None] * np.array(to_rgb(body.color)))
    _add_polygons(ax, np.concatenate(polygons), np.concatenate(colors), zorder=2)


def _add_polygons(ax: Axes, polygons: Floats, colors: Floats | str, zorder: float) -> None:
    # Edges in the color of the faces close the hairlines between neighbors.
    collection = PolyCollection(
        list(polygons), facecolors=colors, edgecolors="face", linewidths=0.15, zorder=zorder
    )
    collection.set_rasterized(True)
    ax.add_collection(collection)


def _above_water(triangles: Floats) -> Floats:
    """Project triangles under water onto the surface, where they are not visible."""
    return np.asarray(np.maximum(triangles, (-np.inf, -np.inf, 0.0)))


def _shadow(triangles: Floats) -> Floats:
    """Project triangles along the sunlight onto the water."""
    return np.asarray(triangles - triangles[..., 2:] / SUN[2] * SUN)


def _far_to_near(camera: Camera, bodies: Iterable[Body]) -> list[Body]:
    """Sort land and piers first, then objects by distance; the solids of an object stay in order."""
    objects: dict[str, list[Body]] = {}
    for body in bodies:
        objects.setdefault(body.name, []).append(body)

    def rank(solids: list[Body]) -> tuple[int, float]:
        kind = solids[0].kind
        center = solids[0].triangles.reshape(-1, 3).mean(axis=0)
        return {"quay": 0, "finger": 1}.get(kind, 2), -float(camera.project(center)[1])

    return [body for solids in sorted(objects.values(), key=rank) for body in solids]


def draw_water(
    ax: Axes, camera: Camera, bounds: tuple[float, float, float, float], color: str = palette.WATER
) -> None:
    """Draw the rectangle (x_min, y_min, x_max, y_max) [m] at z = 0."""
    x0, y0, x1, y1 = bounds
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    ax.add_collection(
        PolyCollection([camera.project(corners)[0]], facecolors=color, edgecolors="none", zorder=1)
    )


def extent(camera: Camera, points: Floats, ratio: float | None = None) -> Floats:
    """Return the rectangle of the image that contains points (k, 3) [m], extended to a width-to-height ratio.

    Returns:
        The lower left and upper right corner (2, 2) in image coordinates.
    """
    flat, _ = camera.project(points)
    low, high = flat.min(axis=0), flat.max(axis=0)
    width, height = high - low
    if ratio is not None:
        width, height = max(width, ratio * height), max(height, width / ratio)
    half = np.array([width, height]) / 2
    return np.array([(low + high) / 2 - half, (low + high) / 2 + half])


def frame(ax: Axes, extent: Floats, background: str) -> None:
    """Show a rectangle of the image, its lower left and upper right corner (2, 2), without axes."""
    (left, bottom), (right, top) = extent
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", facecolor=background)
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def overview_camera(
    bounds: tuple[float, float, float, float], turn_deg: float = 0.0, height_share: float = 0.5
) -> Camera:
    """Return a camera that looks down on a rectangle of water across its longer side, from west or south.

    Args:
        bounds: x_min, y_min, x_max, y_max [m].
        turn_deg: rotation about the center, counterclockwise.
        height_share: height of the camera, relative to the longer side.
    """
    x0, y0, x1, y1 = bounds
    center = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    longest = max(x1 - x0, y1 - y0)
    direction = -0.92 - 0.42j if y1 - y0 >= x1 - x0 else -0.42 - 0.92j
    direction *= complex(math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg)))
    eye = center + longest * np.array([direction.real, direction.imag, height_share])
    return Camera(tuple(eye.tolist()), tuple(center.tolist()))


def least_occluded(cameras: Sequence[Camera], boat: Floats, others: Floats) -> Camera:
    """Return the first camera with the fewest triangles in front of the boat.

    Args:
        boat: (k, 3, 3) triangles of the boat [m].
        others: (m, 3, 3) triangles of everything else [m].
    """

    def in_front(camera: Camera) -> int:
        hull, hull_depth = camera.project(boat.reshape(-1, 3))
        flat, depth = camera.project(others)
        beside = ((flat.max(axis=1) < hull.min(axis=0)) | (flat.min(axis=1) > hull.max(axis=0))).any(axis=1)
        return int((~beside & (depth.min(axis=1) < hull_depth.max())).sum())

    return min(cameras, key=in_front)
