"""LiDAR scans from above and in 3-D, and the camera."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.reports import show, view3d
from dockctl.reports.style import figure_style, make_axes
from dockctl.reports.view3d import Body, Camera
from tests.reports import synthetic

CAMERA = Camera((-10.0, 0.0, 5.0), (0.0, 0.0, 0.0))


def test_the_nearest_point_of_each_sector_is_marked_with_its_distance() -> None:
    points = np.array([[3.0, 1.0, 0.5], [6.0, 2.0, 0.5], [-4.0, -1.0, 1.0], [2.0, -7.0, 2.0]])
    ranges = np.full(8, 100.0)
    for x, y, _ in points:
        sector = math.floor((math.atan2(y, x) + math.pi) / (math.pi / 4))
        ranges[sector] = min(ranges[sector], math.hypot(x, y))
    with figure_style():
        _, ax = make_axes("", "")
        show.draw_sectors(ax, points, ranges, synthetic.marina().hull, 100.0)
    texts = [text.get_text() for text in ax.texts]
    assert texts.count("d5  3.16 m") == 1  # port bow
    assert texts.count("d1  4.12 m") == 1  # starboard quarter
    assert sum(text.endswith("no return") for text in texts) == 5
    marks = [line.get_xydata()[0].tolist() for line in ax.lines if line.get_marker() == "o"]
    assert [-1.0, 3.0] in marks  # bow up, port to the left
    dots = np.asarray(ax.lines[0].get_xydata())
    assert dots == pytest.approx(np.stack([-points[:, 1], points[:, 0]], axis=1))


def test_a_scan_without_returns() -> None:
    with figure_style():
        _, ax = make_axes("", "")
        show.draw_sectors(ax, np.empty((0, 3)), np.full(8, 100.0), synthetic.marina().hull, 100.0)
        show.draw_cloud(ax, CAMERA, np.empty((0, 3)), 1.0)
    assert len([text for text in ax.texts if text.get_text().endswith("no return")]) == 8


def test_projection() -> None:
    flat, depth = CAMERA.project(
        np.array([[0.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [-20.0, 0.0, 10.0]])
    )
    assert flat[0] == pytest.approx([0, 0], abs=1e-12)
    assert depth[0] == pytest.approx(math.hypot(10, 5))
    assert flat[1, 0] > 0  # looking along +x, -y is to the right
    assert flat[2, 1] > 0
    assert depth[3] < 0


def test_back_faces_and_underwater_faces_are_not_drawn() -> None:
    def wall(x: float, z: float, order: int) -> np.ndarray:
        corners = np.array([[x, -1.0, z], [x, 1.0, z], [x, 0.0, z + 1.0]])
        return corners[None, ::order]

    bodies = [
        Body("seen", "quay", wall(0.0, 0.0, -1)),
        Body("turned away", "quay", wall(1.0, 0.0, 1)),
        Body("sunk", "quay", wall(2.0, -3.0, -1)),
    ]
    with figure_style():
        _, ax = make_axes("", "")
        view3d.draw_bodies(ax, CAMERA, bodies)
    assert len(ax.collections[-1].get_paths()) == 1


@given(st.one_of(st.none(), st.floats(0.3, 3.0)))
def test_extent_contains_its_points_at_the_given_ratio(ratio: float | None) -> None:
    points = np.array([[0.0, -3.0, 0.0], [2.0, 4.0, 1.0], [5.0, 0.0, 2.0]])
    low, high = view3d.extent(CAMERA, points, ratio)
    flat, _ = CAMERA.project(points)
    assert (flat >= low - 1e-9).all()
    assert (flat <= high + 1e-9).all()
    if ratio is not None:
        assert (high - low)[0] / (high - low)[1] == pytest.approx(ratio)


def test_overview_camera_is_across_the_longer_side() -> None:
    tall, wide = view3d.overview_camera((0, 0, 10, 80)), view3d.overview_camera((0, 0, 80, 10))
    assert abs(tall.eye[0] - 5) > abs(tall.eye[1] - 40)
    assert abs(wide.eye[1] - 5) > abs(wide.eye[0] - 40)


def test_least_occluded_camera() -> None:
    boat = np.array([[[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 1.0, 0.5]]])
    mast = np.array([[[-5.0, -0.1, 0.0], [-5.0, 0.1, 0.0], [-5.0, 0.0, 9.0]]])
    west, south = view3d.Camera((-20, 0, 3), (0, 0, 0)), view3d.Camera((0, -20, 3), (0, 0, 0))
    behind = view3d.Camera((20, 0, 3), (0, 0, 0))
    assert view3d.least_occluded([west, south], boat, mast) is south
    assert view3d.least_occluded([west, behind], boat, mast) is behind
    assert view3d.least_occluded([west, south], boat, mast + (0.0, 30.0, 0.0)) is west  # the first
