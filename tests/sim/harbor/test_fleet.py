"""The builders against closed forms, and every model of the fleet against what a vessel must be."""

from __future__ import annotations

import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.drawing.scene import KINDS
from dockctl.scenarios.harbor import ModelName
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.fleet import MODELS, MooredModel, moored_model
from dockctl.sim.harbor.outlines import outlines
from dockctl.sim.harbor.solids import box, loft, prism, rounded, tube
from dockctl.sim.hull import hull_mesh, hull_outline

lengths = st.floats(0.1, 20.0)


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> MooredModel:
    return moored_model(request.param)


def test_every_piece_is_a_closed_solid_facing_outwards(model: MooredModel) -> None:
    for solid in model.solids:
        assert solid.mesh.is_watertight
        assert solid.mesh.is_winding_consistent
        assert solid.mesh.volume > 0
        assert solid.kind in KINDS
    assert model.mesh.is_watertight


def test_models_have_the_size_of_their_class(model: MooredModel) -> None:
    assert 500 <= len(model.mesh.faces) <= 3000
    assert 5.0 <= model.mesh.extents[0] <= 10.0
    assert 1.6 <= model.beam <= 3.4
    assert model.mesh.bounds[1, 2] <= 12.0


def test_models_float_upright_around_their_centre_line_with_the_stern_at_zero(model: MooredModel) -> None:
    low, high = model.mesh.bounds
    assert low[0] == pytest.approx(0.0, abs=1e-12)
    assert low[1] == pytest.approx(-high[1], abs=1e-3)
    assert low[2] < 0.0 < high[2]


@pytest.mark.parametrize(("noun", "count"), [("open boat", 3), ("sailing boat", 4), ("motor yacht", 3)])
def test_classes_of_the_appendix(noun: str, count: int) -> None:
    assert [kind for kind, _ in MODELS.values()].count(noun) == count


def test_masts_stand_on_sailing_boats_alone() -> None:
    tall = {name for name in MODELS if moored_model(name).mesh.bounds[1, 2] > 7.0}
    assert tall == {"dinghy", "daysailer", "sloop", "cruiser", "catamaran"}


def test_scenario_files_know_the_models_by_name() -> None:
    assert list(get_args(ModelName)) == list(MODELS)


@given(lengths, lengths, lengths)
def test_box_has_its_volume(a: float, b: float, c: float) -> None:
    mesh = box((0, 0, 0), (a, b, c))
    assert mesh.volume == pytest.approx(a * b * c)
    assert mesh.area == pytest.approx(2 * (a * b + b * c + c * a))


@given(st.integers(3, 40), lengths, lengths)
def test_tube_is_a_regular_prism(sides: int, radius: float, length: float) -> None:
    mesh = tube([(0, 0, 0), (0, 0, length)], radius, sides)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(0.5 * sides * radius**2 * math.sin(2 * math.pi / sides) * length)


@given(st.integers(3, 12), st.floats(1.5, 6.0))
def test_bent_tubes_stay_closed_and_as_thick_as_they_were(sides: int, turns: float) -> None:
    t = np.linspace(0, turns, 60)
    path = np.stack((3 * np.cos(t), 3 * np.sin(t), 0.5 * t), axis=1)
    mesh = tube(path, 0.1, sides)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert mesh.volume == pytest.approx(0.5 * sides * 0.01 * math.sin(2 * math.pi / sides) * length, rel=0.02)


@pytest.mark.parametrize("k", range(3, 12))
def test_caps_cover_convex_rings_exactly(k: int) -> None:
    angles = 2 * np.pi * np.arange(k) / k
    mesh = prism(np.stack((np.cos(angles), np.sin(angles)), axis=1), 0.0, 1.0)
    assert mesh.area == pytest.approx(k * math.sin(2 * math.pi / k) + 2 * k * math.sin(math.pi / k))


def test_lofts_face_outwards_whichever_way_the_rings_run() -> None:
    ring = np.column_stack((rounded(1.0, 0.5), np.zeros(16)))
    above = ring + np.array([0, 0, 1])
    for rings in ([ring, above], [above, ring], [ring[::-1], above[::-1]]):
        assert loft(rings).volume > 0


@given(st.builds(Hull, length_m=lengths, beam_m=lengths, draft_m=lengths, freeboard_m=lengths))
def test_own_hull_is_convex_and_fills_its_measures(hull: Hull) -> None:
    mesh = hull_mesh(hull)
    assert mesh.is_watertight
    assert mesh.is_convex
    half_length, half_beam = hull.length_m / 2, hull.beam_m / 2
    corners = [[-half_length, -half_beam, -hull.draft_m], [half_length, half_beam, hull.freeboard_m]]
    np.testing.assert_allclose(mesh.bounds, corners)


def test_own_hull_from_above_is_its_outline() -> None:
    ((xy, height),) = outlines(hull_mesh(Hull()))
    assert height == Hull().freeboard_m
    assert {tuple(p) for p in xy} == {tuple(p) for p in hull_outline(Hull())}


def test_outline_of_a_bowl_shows_the_rim_and_the_sole() -> None:
    bowl = loft([np.column_stack((x * rounded(1, 1, 8), np.full(16, z))) for x, z in
                 ((1, 0), (1, 1), (0.8, 1), (0.8, 0.5))])  # fmt: skip
    areas = sorted(_area(xy) for xy, _ in outlines(bowl))
    assert areas == pytest.approx([0.64 * _area(rounded(1, 1, 8)), _area(rounded(1, 1, 8))])


def _area(xy: np.ndarray) -> float:
    x, y = xy.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
