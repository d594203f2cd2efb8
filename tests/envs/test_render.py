"""Rendered frames."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from PIL import ImageColor

from dockctl.drawing import palette
from dockctl.envs.render import Canvas, draw_frame
from tests.reports import synthetic

SCENE = synthetic.marina()
ETA, GOAL = np.array([20.0, 2.0, math.radians(160)]), np.array([36.0, 0.0, math.pi])
TRAIL = np.array([[20.0, -10.0], [20.0, 2.0]])


def color_at(frame: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    column, row = Canvas.of(SCENE, max(frame.shape)).pixels(np.array([[x, y]]))[0].astype(int)
    return tuple(int(value) for value in frame[row, column])


def test_a_frame_shows_water_boat_and_quay_at_their_positions() -> None:
    frame = draw_frame(SCENE, ETA, GOAL, TRAIL)
    assert frame.dtype == np.uint8
    assert frame.shape[2] == 3
    assert max(frame.shape) == 900
    assert color_at(frame, 20.0, 20.0) == ImageColor.getrgb(palette.WATER)
    assert color_at(frame, 40.0, 10.0) == ImageColor.getrgb(palette.SOLIDS["quay"][0])
    astern = ETA[:2] - 1.0 * np.array([math.cos(ETA[2]), math.sin(ETA[2])])
    assert color_at(frame, *astern) == ImageColor.getrgb(palette.OWN_HULL)


def test_sides_are_even_for_video_encoders() -> None:
    for longest in (301, 450, 900):
        height, width, _ = draw_frame(SCENE, ETA, GOAL, TRAIL, longest_px=longest).shape
        assert height % 2 == 0
        assert width % 2 == 0
        assert abs(height - longest) <= 1


def test_frames_do_not_change_the_cached_harbor() -> None:
    first = draw_frame(SCENE, ETA, GOAL, TRAIL)
    draw_frame(SCENE, GOAL, GOAL, TRAIL)
    assert np.array_equal(first, draw_frame(SCENE, ETA, GOAL, TRAIL))


def test_trails_with_headings_or_with_a_single_pose() -> None:
    long = draw_frame(SCENE, ETA, GOAL, np.column_stack([TRAIL, [1.0, 1.0]]))
    assert np.array_equal(long, draw_frame(SCENE, ETA, GOAL, TRAIL))
    draw_frame(SCENE, ETA, GOAL, ETA[None])


def test_a_boat_outside_the_image_is_not_drawn() -> None:
    far = np.array([500.0, 500.0, 0.0])
    bare = draw_frame(SCENE, far, far, far[None])
    assert color_at(bare, *ETA[:2]) == ImageColor.getrgb(palette.WATER)


def test_a_harbor_without_quays_has_water_around_it() -> None:
    bare = replace(SCENE, polygons=tuple(p for p in SCENE.polygons if p.kind != "quay"))
    assert Canvas.of(bare, 900).left < Canvas.of(SCENE, 900).left
