"""Angles, poses and sectors against trigonometry and hand-computed numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dockctl.geometry import (
    nearest_in_sectors,
    pose_label,
    relocate_poses,
    sector_edges_deg,
    sector_index,
    to_world,
    wrap,
)

PI = math.pi
coordinate, angle = st.floats(-50, 50), st.floats(-math.pi, math.pi)
poses = st.tuples(coordinate, coordinate, angle).map(np.array)


def just_below(value: float) -> float:
    return float(np.nextafter(value, -math.inf))


def just_above(value: float) -> float:
    return float(np.nextafter(value, math.inf))


@given(angle=st.floats(-1000, 1000))
@example(angle=PI)
@example(angle=-PI)
@example(angle=just_above(PI))
@example(angle=just_below(-PI))
@example(angle=just_above(-PI))
@example(angle=3 * PI)
@example(angle=-3 * PI)
@example(angle=-1e-320)
def test_wrap_stays_in_the_half_open_turn_and_keeps_the_direction(angle: float) -> None:
    wrapped = float(wrap(np.array([angle]))[0])
    assert -PI < wrapped <= PI
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-12)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-12)


@given(angle=st.floats(-PI, PI, exclude_min=True))
def test_wrap_leaves_angles_inside_alone(angle: float) -> None:
    assert wrap(np.array([angle]))[0] == angle


def test_minus_half_a_turn_is_plus_half_a_turn() -> None:
    assert wrap(np.array([-PI, PI])).tolist() == [PI, PI]


@given(first=poses, second=poses, origin=poses, to=poses, mirrored=st.booleans())
def test_transfer_preserves_distances_and_turns_and_mirroring_swaps_the_sides(
    first: np.ndarray, second: np.ndarray, origin: np.ndarray, to: np.ndarray, mirrored: bool
) -> None:
    before = np.stack([first, second])
    after = relocate_poses(before, origin, to, mirrored)
    assert np.hypot(*(after[0] - after[1])[:2]) == pytest.approx(np.hypot(*(first - second)[:2]), abs=1e-9)
    turned = wrap(np.array([second[2] - first[2], after[1, 2] - after[0, 2]]))
    assert math.cos(turned[0]) == pytest.approx(math.cos(turned[1]), abs=1e-9)
    assert math.sin(turned[0]) == pytest.approx(math.sin(turned[1]) * (-1 if mirrored else 1), abs=1e-9)
    assert relocate_poses(origin[None], origin, to, mirrored)[0, :2] == pytest.approx(to[:2], abs=1e-9)
    back = relocate_poses(after, to, origin, mirrored)
    assert back[:, :2] == pytest.approx(before[:, :2], abs=1e-9)


def test_points_are_rotated_then_shifted() -> None:
    placed = to_world(np.array([[1.5, 0.0], [0.0, 0.5]]), np.array([20.0, 2.0, PI / 2]))
    assert placed == pytest.approx(np.array([[20.0, 3.5], [19.5, 2.0]]))
    solid = to_world(np.array([[[1.0, 0.0, 2.0]]]), np.array([10.0, 5.0, PI / 2]))
    assert solid == pytest.approx(np.array([[[10.0, 6.0, 2.0]]]))


@given(st.floats(-PI, PI), st.sampled_from([1, 4, 8, 12]))
def test_sectors_are_equal_and_begin_astern(theta: float, count: int) -> None:
    sector = sector_index(theta, count)
    edges = np.linspace(-PI, PI, count + 1)
    assert edges[sector] - 1e-12 <= theta <= edges[sector + 1] + 1e-12
    np.testing.assert_allclose(np.radians(sector_edges_deg(count)), edges, rtol=0, atol=1e-12)


@pytest.mark.parametrize("count", [1, 4, 8, 12])
def test_both_sides_of_every_edge_between_sectors(count: int) -> None:
    edges = np.linspace(-PI, PI, count + 1)
    for sector in range(count):
        for theta in (edges[sector] + 1e-9, edges[sector + 1] - 1e-9):
            point = np.array([10 * math.cos(theta), 10 * math.sin(theta)])
            assert sector_index(theta, count) == sector
            assert nearest_in_sectors(point[None], count, 60.0).argmin() == sector


@given(
    st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=20),
    st.integers(1, 36),
)
def test_all_points_at_once_are_in_the_sectors_of_each(points: list[tuple[float, float]], count: int) -> None:
    nearest = np.full(count, 60.0)
    for x, y in points:
        sector = sector_index(math.atan2(y, x), count)
        nearest[sector] = min(nearest[sector], math.hypot(x, y))
    np.testing.assert_allclose(
        nearest_in_sectors(np.array(points), count, 60.0), nearest, rtol=1e-15, atol=1e-12
    )


def test_the_point_right_astern_belongs_to_the_last_sector() -> None:
    assert sector_index(math.atan2(0.0, -1.0), 8) == 7
    assert sector_index(math.atan2(-0.0, -1.0), 8) == 0


@pytest.mark.parametrize(
    ("pose", "text"),
    [
        ((20, 2, -200), "(20, 2, 160°)"),
        ((-0.004, -1.25, 360), "(0, −1.25, 0°)"),
        ((1, 1, 359.999), "(1, 1, 0°)"),
    ],
)
def test_pose_labels(pose: tuple[float, float, float], text: str) -> None:
    assert pose_label(*pose) == text
