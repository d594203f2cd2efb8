"""Closed solids, the hull and its outline against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.solids import box, hull_mesh, hull_outline, loft, outlines, prism, tube
from tests.sim.meshes import peer

lengths = st.floats(0.1, 20.0)
TURN = np.arange(16) * (2 * np.pi / 16)
ELLIPSE = np.column_stack((np.cos(TURN), 0.5 * np.sin(TURN)))


@given(lengths, lengths, lengths)
def test_volume_and_area_of_a_box(a: float, b: float, c: float) -> None:
    mesh = peer(box((0, 0, 0), (a, b, c)))
    assert mesh.volume == pytest.approx(a * b * c)
    assert mesh.area == pytest.approx(2 * (a * b + b * c + c * a))


@given(st.integers(3, 40), lengths, lengths)
def test_tube_is_a_regular_prism(sides: int, radius: float, length: float) -> None:
    mesh = peer(tube([(0, 0, 0), (0, 0, length)], radius, sides))
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.5 * sides * radius**2 * math.sin(2 * math.pi / sides) * length)


@given(st.integers(3, 12), st.floats(1.5, 6.0))
def test_bent_tubes_are_closed_and_have_the_full_thickness(sides: int, turns: float) -> None:
    t = np.linspace(0, turns, 60)
    path = np.stack((3 * np.cos(t), 3 * np.sin(t), 0.5 * t), axis=1)
    mesh = peer(tube(path, 0.1, sides))
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert mesh.volume == pytest.approx(0.5 * sides * 0.01 * math.sin(2 * math.pi / sides) * length, rel=0.02)


@pytest.mark.parametrize("k", range(3, 12))
def test_caps_cover_convex_rings_exactly(k: int) -> None:
    angles = 2 * np.pi * np.arange(k) / k
    mesh = peer(prism(np.stack((np.cos(angles), np.sin(angles)), axis=1), 0.0, 1.0))
    assert mesh.area == pytest.approx(k * math.sin(2 * math.pi / k) + 2 * k * math.sin(math.pi / k))


def test_lofts_face_outwards_whichever_way_the_rings_run() -> None:
    ring = np.column_stack((ELLIPSE, np.zeros(16)))
    above = ring + np.array([0, 0, 1])
    for rings in ([ring, above], [above, ring], [ring[::-1], above[::-1]]):
        assert peer(loft(rings)).volume > 0


@given(st.builds(Hull, length_m=lengths, beam_m=lengths, draft_m=lengths, freeboard_m=lengths))
def test_the_own_hull_is_convex_and_has_the_given_size(hull: Hull) -> None:
    mesh = peer(hull_mesh(hull))
    assert mesh.is_watertight
    assert mesh.is_convex
    half_length, half_beam = hull.length_m / 2, hull.beam_m / 2
    corners = [[-half_length, -half_beam, -hull.draft_m], [half_length, half_beam, hull.freeboard_m]]
    np.testing.assert_allclose(mesh.bounds, corners)


def test_the_own_hull_from_above_is_its_outline() -> None:
    ((xy, height),) = outlines(hull_mesh(Hull()))
    assert height == Hull().freeboard_m
    assert {tuple(p) for p in xy} == {tuple(p) for p in hull_outline(Hull())}


def test_outlines_of_a_bowl_are_its_rim_and_its_sole() -> None:
    bowl = loft([np.column_stack((x * ELLIPSE, np.full(16, z))) for x, z in
                 ((1, 0), (1, 1), (0.8, 1), (0.8, 0.5))])  # fmt: skip
    areas = sorted(_area(xy) for xy, _ in outlines(bowl))
    assert areas == pytest.approx([0.64 * _area(ELLIPSE), _area(ELLIPSE)])


def _area(xy: np.ndarray) -> float:
    x, y = xy.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
