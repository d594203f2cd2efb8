"""Plan views for ``render_mode="rgb_array"``: the harbor is drawn once, boat and path in every frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from dockctl.drawing import palette
from dockctl.drawing.scene import Scene, strokes, water
from dockctl.geometry import Floats, to_world

Frame = NDArray[np.uint8]

SUPERSAMPLING = 4  # everything is drawn larger by this factor and averaged down, for smooth edges
MARGIN_M = 2.0  # width of the land shown around the water


@dataclass(frozen=True)
class Canvas:
    """Mapping from world to image: top left corner [m], scale [px/m] and size [px]."""

    left: float
    top: float
    scale: float
    width: int
    height: int

    @classmethod
    def of(cls, scene: Scene, longest_px: int) -> Canvas:
        """Fit all the water; width and height are even, as video encoders require."""
        x_min, y_min, x_max, y_max = water(scene)
        wide, high = x_max - x_min + 2 * MARGIN_M, y_max - y_min + 2 * MARGIN_M
        scale = longest_px / max(wide, high)
        width, height = (max(2, 2 * round(side * scale / 2)) for side in (wide, high))
        return cls(x_min - MARGIN_M, y_max + MARGIN_M, scale, width, height)

    def pixels(self, xy: Floats) -> Floats:
        """Convert world coordinates (k, 2) [m] to columns and rows (k, 2); rows count downwards."""
        return np.asarray(np.stack([xy[:, 0] - self.left, self.top - xy[:, 1]], axis=1) * self.scale)


def draw_frame(scene: Scene, eta: Floats, goal: Floats, trail: Floats, *, longest_px: int = 900) -> Frame:
    """Draw one boat in the harbor.

    Args:
        scene: the harbor and the boat's outline.
        eta: (3,) x, y [m] and heading [rad] of the boat.
        goal: (3,) pose of the current goal.
        trail: (k, 2) or (k, 3) poses of the boat so far.
        longest_px: longer side of the image.

    Returns:
        (height, width, 3) RGB.
    """
    canvas = Canvas.of(scene, longest_px)
    image = _harbor(scene, longest_px).copy()
    boat, berth = (canvas.pixels(to_world(scene.hull, pose)) for pose in (eta, goal))
    path = canvas.pixels(np.asarray(trail, float).reshape(len(trail), -1)[:, :2])
    shown = np.concatenate([boat, berth, path])
    low = np.clip(np.floor(shown.min(axis=0)) - 4, 0, (canvas.width, canvas.height)).astype(int)
    high = np.clip(np.ceil(shown.max(axis=0)) + 4, 0, (canvas.width, canvas.height)).astype(int)
    if (high <= low).any():
        return np.asarray(image)
    # Only the region that boat, path and goal cover is drawn again.
    width, height = (int(side) for side in (high - low) * SUPERSAMPLING)
    layer = Image.new("RGBA", (width, height), (255, 255, 255, 0))
    pen = ImageDraw.Draw(layer)

    def fine(points: Floats) -> list[tuple[float, float]]:
        return [(float(x), float(y)) for x, y in (points - low) * SUPERSAMPLING]

    meter = canvas.scale * SUPERSAMPLING
    thin = max(1, round(0.12 * meter))
    pen.polygon(fine(berth), fill=_with_alpha(palette.GOAL, 70))
    pen.line([*fine(berth), *fine(berth)[:2]], fill=palette.GOAL, width=thin, joint="curve")
    if len(path) > 1:
        pen.line(
            fine(path), fill=_with_alpha(palette.BLUE, 210), width=max(1, round(0.16 * meter)), joint="curve"
        )
    pen.polygon(fine(boat), fill=palette.OWN_HULL)
    pen.line([*fine(boat), *fine(boat)[:2]], fill=palette.INK, width=thin, joint="curve")
    bow = canvas.pixels(to_world(np.array([[0.0, 0.0], [0.8 * scene.hull[:, 0].max(), 0.0]]), eta))
    pen.line(fine(bow), fill="white", width=max(1, round(0.2 * meter)))
    small = layer.reduce(SUPERSAMPLING)
    image.paste(small, (int(low[0]), int(low[1])), small)
    return np.asarray(image)


@lru_cache(maxsize=4)
def _harbor(scene: Scene, longest_px: int) -> Image.Image:
    """Return the harbor without the boat."""
    canvas = Canvas.of(scene, longest_px)
    image = Image.new("RGB", (canvas.width * SUPERSAMPLING, canvas.height * SUPERSAMPLING), palette.WATER)
    pen = ImageDraw.Draw(image)
    for stroke in strokes(scene):
        points = [(float(x), float(y)) for x, y in canvas.pixels(stroke.xy) * SUPERSAMPLING]
        width = max(1, round(stroke.width_m * canvas.scale * SUPERSAMPLING))
        if stroke.fill is not None:
            pen.polygon(points, fill=stroke.fill)
        if stroke.edge is not None:
            pen.line([*points, points[0]], fill=stroke.edge, width=width)
    return image.reduce(SUPERSAMPLING)


def _with_alpha(color: str, alpha: int) -> tuple[int, ...]:
    return (*ImageColor.getrgb(color)[:3], alpha)
