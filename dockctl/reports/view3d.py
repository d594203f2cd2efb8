"""The harbor and the LiDARs' points in three dimensions (thesis Fig. 3.6), seen by a pinhole camera."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from dockctl.drawing import palette

Floats = NDArray[np.float64]

SUN = np.array([-0.45, -0.35, 0.82]) / np.linalg.norm([-0.45, -0.35, 0.82])
NEAR_M = 1.0


@dataclass(frozen=True, eq=False)
class Body:
    """Something solid: a color and its (m, 3, 3) triangles in the world frame [m], facing outwards."""

    name: str
    kind: str
    triangles: Floats

    @property
    def color(self) -> str:
        return palette.solid_color(self.kind, self.name)


@dataclass(frozen=True)
class Camera:
    """A pinhole at `eye` that looks at `target`, both (x, y, z) [m]."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]

    @cached_property
    def axes(self) -> Floats:
        """Rows: right, up, forward."""
        forward = np.subtract(self.target, self.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, (0.0, 0.0, 1.0))
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, forward), forward])

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Return (..., 2) places on the picture and (...) depths [m] of (..., 3) points."""
        seen = (points - np.asarray(self.eye)) @ self.axes.T
        depth = np.maximum(seen[..., 2], NEAR_M)
        return seen[..., :2] / depth[..., None], seen[..., 2]


def draw_bodies(ax: Axes, camera: Camera, bodies: Sequence[Body], *, shadows: bool = True) -> None:
    """Paint solids and their shadows on the water, the farthest first; what faces away is left out."""
    above = [Body(body.name, body.kind, _above_water(body.triangles)) for body in bodies]
    for body in above if shadows else ():
        if body.kind != "quay":
            _paint(ax, camera.project(_shadow(body.triangles))[0], palette.WATER_SHADE, zorder=1.5)
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
    _paint(ax, np.concatenate(polygons), np.concatenate(colors), zorder=2)


def _paint(ax: Axes, polygons: Floats, colors: Floats | str, zorder: float) -> None:
    # Edges in the color of the face close the hairlines between neighbours.
    collection = PolyCollection(
        list(polygons), facecolors=colors, edgecolors="face", linewidths=0.15, zorder=zorder
    )
    collection.set_rasterized(True)
    ax.add_collection(collection)


def _above_water(triangles: Floats) -> Floats:
    """Press everything under water flat against the surface, where it is no longer seen."""
    return np.asarray(np.maximum(triangles, (-np.inf, -np.inf, 0.0)))


def _shadow(triangles: Floats) -> Floats:
    """Slide triangles along the sunlight onto the water."""
    return np.asarray(triangles - triangles[..., 2:] / SUN[2] * SUN)


def _far_to_near(camera: Camera, bodies: Iterable[Body]) -> list[Body]:
    """Land and piers first, then thing after thing by distance; the solids of one keep their order."""
    things: dict[str, list[Body]] = {}
    for body in bodies:
        things.setdefault(body.name, []).append(body)

    def rank(thing: list[Body]) -> tuple[int, float]:
        low = thing[0].kind in ("quay", "finger")
        centre = thing[0].triangles.reshape(-1, 3).mean(axis=0)
        return (0 if thing[0].kind == "quay" else 1 if low else 2), -float(camera.project(centre)[1])

    return [body for thing in sorted(things.values(), key=rank) for body in thing]


def draw_water(
    ax: Axes, camera: Camera, bounds: tuple[float, float, float, float], color: str = palette.WATER
) -> None:
    """Paint the rectangle (x_min, y_min, x_max, y_max) at z = 0."""
    x0, y0, x1, y1 = bounds
    corners = np.array([[x0, y0, 0.0], [x1, y0, 0.0], [x1, y1, 0.0], [x0, y1, 0.0]])
    ax.add_collection(
        PolyCollection([camera.project(corners)[0]], facecolors=color, edgecolors="none", zorder=1)
    )


def extent(camera: Camera, points: Floats, ratio: float | None = None) -> Floats:
    """Rectangle of the picture that holds (k, 3) points, widened or heightened to a ratio of width to height.

    Returns:
        (2, 2) lower left and upper right corner.
    """
    flat, _ = camera.project(points)
    low, high = flat.min(axis=0), flat.max(axis=0)
    width, height = high - low
    if ratio is not None:
        width, height = max(width, ratio * height), max(height, width / ratio)
    half = np.array([width, height]) / 2
    return np.array([(low + high) / 2 - half, (low + high) / 2 + half])


def frame(ax: Axes, extent: Floats, background: str) -> None:
    """Show a rectangle of the picture, on a plain background and without axes."""
    (left, bottom), (right, top) = extent
    ax.set_xlim(left, right)
    ax.set_ylim(bottom, top)
    ax.set_aspect("equal")
    ax.set_facecolor(background)
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def overlook(
    bounds: tuple[float, float, float, float], turn_deg: float = 0.0, height_share: float = 0.5
) -> Camera:
    """Camera that looks down across the longer side of a rectangle of water, from the west or the south.

    Args:
        bounds: x_min, y_min, x_max, y_max [m].
        turn_deg: by which it goes around the water, counter-clockwise.
        height_share: its height in parts of the longer side.
    """
    x0, y0, x1, y1 = bounds
    centre = np.array([(x0 + x1) / 2, (y0 + y1) / 2, 0.0])
    longest = max(x1 - x0, y1 - y0)
    aside = -0.92 - 0.42j if y1 - y0 >= x1 - x0 else -0.42 - 0.92j
    aside *= complex(math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg)))
    eye = centre + longest * np.array([aside.real, aside.imag, height_share])
    return Camera(tuple(eye.tolist()), tuple(centre.tolist()))


def clearest(cameras: Sequence[Camera], boat: Floats, others: Floats) -> Camera:
    """Return the camera that has the least in front of the boat, the first of several such.

    Args:
        boat: (k, 3, 3) its triangles.
        others: (m, 3, 3) those of everything else.
    """

    def in_front(camera: Camera) -> int:
        own, own_depth = camera.project(boat.reshape(-1, 3))
        flat, depth = camera.project(others)
        beside = ((flat.max(axis=1) < own.min(axis=0)) | (flat.min(axis=1) > own.max(axis=0))).any(axis=1)
        return int((~beside & (depth.min(axis=1) < own_depth.max())).sum())

    return min(cameras, key=in_front)


def placed(triangles: Floats, pose: Floats) -> Floats:
    """Move (..., 3) points from the body frame to a pose (x [m], y [m], heading [rad])."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    turn = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(triangles @ turn + (pose[0], pose[1], 0.0))
