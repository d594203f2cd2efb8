"""Pictures from above for ``render_mode="rgb_array"``: the harbor once, boat and path in every frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageColor, ImageDraw

from dockctl.drawing import palette
from dockctl.drawing.plan import strokes, water
from dockctl.drawing.scene import Scene
from dockctl.geometry import place_outline

Floats = NDArray[np.float64]
Frame = NDArray[np.uint8]

FINER = 4  # everything is drawn this much larger and averaged down, for smooth edges
MARGIN_M = 2.0  # of land around the water


@dataclass(frozen=True)
class Canvas:
    """Where the world lies on a picture: its top left corner [m], the scale [px/m] and the size [px]."""

    left: float
    top: float
    scale: float
    width: int
    height: int

    @classmethod
    def of(cls, scene: Scene, longest_px: int) -> Canvas:
        """Show all the water; both sides of the picture are even, as video encoders want them."""
        x_min, y_min, x_max, y_max = water(scene)
        wide, high = x_max - x_min + 2 * MARGIN_M, y_max - y_min + 2 * MARGIN_M
        scale = longest_px / max(wide, high)
        width, height = (max(2, 2 * round(side * scale / 2)) for side in (wide, high))
        return cls(x_min - MARGIN_M, y_max + MARGIN_M, scale, width, height)

    def pixels(self, xy: Floats) -> Floats:
        """World (k, 2) [m] to (k, 2) columns and rows; rows count downwards."""
        return np.asarray(np.stack([xy[:, 0] - self.left, self.top - xy[:, 1]], axis=1) * self.scale)


def draw_frame(scene: Scene, eta: Floats, goal: Floats, trail: Floats, *, longest_px: int = 900) -> Frame:
    """Draw one boat in the marina.

    Args:
        scene: the harbor and the boat's outline.
        eta: (3,) x, y [m] and heading [rad] of the boat.
        goal: (3,) pose of the current goal.
        trail: (k, 2) or (k, 3) poses that the boat has come through.
        longest_px: longer side of the picture.

    Returns:
        (height, width, 3) RGB.
    """
    canvas = Canvas.of(scene, longest_px)
    picture = _harbor(scene, longest_px).copy()
    boat, berth = (canvas.pixels(place_outline(scene.hull, pose)) for pose in (eta, goal))
    path = canvas.pixels(np.asarray(trail, float).reshape(len(trail), -1)[:, :2])
    shown = np.concatenate([boat, berth, path])
    low = np.clip(np.floor(shown.min(axis=0)) - 4, 0, (canvas.width, canvas.height)).astype(int)
    high = np.clip(np.ceil(shown.max(axis=0)) + 4, 0, (canvas.width, canvas.height)).astype(int)
    if (high <= low).any():
        return np.asarray(picture)
    # Only the part of the picture that boat, path and goal touch is drawn anew.
    width, height = (int(side) for side in (high - low) * FINER)
    layer = Image.new("RGBA", (width, height), (255, 255, 255, 0))
    pen = ImageDraw.Draw(layer)

    def fine(points: Floats) -> list[tuple[float, float]]:
        return [(float(x), float(y)) for x, y in (points - low) * FINER]

    metre = canvas.scale * FINER
    thin = max(1, round(0.12 * metre))
    pen.polygon(fine(berth), fill=_with_alpha(palette.GOAL, 70))
    pen.line([*fine(berth), *fine(berth)[:2]], fill=palette.GOAL, width=thin, joint="curve")
    if len(path) > 1:
        pen.line(
            fine(path), fill=_with_alpha(palette.BLUE, 210), width=max(1, round(0.16 * metre)), joint="curve"
        )
    pen.polygon(fine(boat), fill=palette.OWN_HULL)
    pen.line([*fine(boat), *fine(boat)[:2]], fill=palette.INK, width=thin, joint="curve")
    bow = canvas.pixels(place_outline(np.array([[0.0, 0.0], [0.8 * scene.hull[:, 0].max(), 0.0]]), eta))
    pen.line(fine(bow), fill="white", width=max(1, round(0.2 * metre)))
    small = layer.reduce(FINER)
    picture.paste(small, (int(low[0]), int(low[1])), small)
    return np.asarray(picture)


@lru_cache(maxsize=4)
def _harbor(scene: Scene, longest_px: int) -> Image.Image:
    """The harbor without boat; drawn once for a scene."""
    canvas = Canvas.of(scene, longest_px)
    picture = Image.new("RGB", (canvas.width * FINER, canvas.height * FINER), palette.WATER)
    pen = ImageDraw.Draw(picture)
    for stroke in strokes(scene):
        points = [(float(x), float(y)) for x, y in canvas.pixels(stroke.xy) * FINER]
        width = max(1, round(stroke.width_m * canvas.scale * FINER))
        if stroke.fill is not None:
            pen.polygon(points, fill=stroke.fill)
        if stroke.edge is not None:
            pen.line([*points, points[0]], fill=stroke.edge, width=width)
    return picture.reduce(FINER)


def _with_alpha(color: str, alpha: int) -> tuple[int, ...]:
    return (*ImageColor.getrgb(color)[:3], alpha)
