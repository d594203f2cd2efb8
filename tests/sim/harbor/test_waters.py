"""Water that is connected for a boat, compared with paths that the boat can move along."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Hull
from dockctl.sim.collision import CollisionChecker
from dockctl.sim.harbor.build import assemble
from dockctl.sim.harbor.solids import Part, Solid, box
from dockctl.sim.harbor.waters import Waters, connected_cells

HULL = Hull()
Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def walls(*boxes: Box) -> Floats:
    return np.concatenate([np.asarray(box(low, high).triangles) for low, high in boxes])


def ring(gap_m: float = 0.0, z: tuple[float, float] = (-1.0, 1.0), at: float = 0.0) -> Floats:
    """Return four walls around a square of 20 m, with a gap in the east."""
    bottom, top = z
    low, high, thick = at - 10, at + 10, 0.3
    boxes: list[Box] = [
        ((low - thick, low, bottom), (low, high, top)),
        ((low, low - thick, bottom), (high, low, top)),
        ((low, high, bottom), (high, high + thick, top)),
        ((high, low - thick, bottom), (high + thick, at - gap_m / 2, top)),
    ]
    return walls(*boxes, ((high, at + gap_m / 2, bottom), (high + thick, high + thick, top)))


def connected(waters: Waters, one: Sequence[float], other: Sequence[float]) -> bool:
    first, second = waters.region(np.array([[*one, 0.0], [*other, 0.0]]))
    return bool(first == second)


@given(
    st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 30), st.sampled_from([0.3, 0.55, 0.7, 1.0])
)
def test_connected_cells_have_the_numbers_of_scipy(seed: int, rows: int, columns: int, share: float) -> None:
    cells = np.random.default_rng(seed).random((rows, columns)) < share
    numbers, count = connected_cells(cells)
    expected, expected_count = label(cells)
    assert count == expected_count
    np.testing.assert_array_equal(numbers, expected)


@pytest.mark.parametrize("at", [0.0, 1e5])
def test_a_closed_basin_is_separate_from_the_water_around_it(at: float) -> None:
    waters = Waters(ring(at=at), HULL)
    assert connected(waters, (at - 9, at - 9), (at + 9, at + 9))
    assert not connected(waters, (at, at), (at + 15, at))
    assert connected(waters, (at + 15, at), (at - 500, at + 900))


@pytest.mark.parametrize(("gap_m", "open_"), [(0.05, False), (1.1, True), (3.0, True)])
def test_a_gap_that_the_boat_fits_through_connects(gap_m: float, open_: bool) -> None:
    assert connected(Waters(ring(gap_m), HULL), (0, 0), (15, 0)) == open_


@pytest.mark.parametrize(
    ("z", "open_"),
    [
        ((0.7, 2.0), True),
        ((-5.0, -0.4), True),
        ((-5.0, -0.2), False),
        ((0.4, 2.0), False),
        ((-0.1, 0.2), False),
    ],
)
def test_only_obstacles_between_keel_and_deck_separate(z: tuple[float, float], open_: bool) -> None:
    """The boat floats from -0.3 m to 0.5 m."""
    assert connected(Waters(ring(z=z), HULL), (0, 0), (15, 0)) == open_


def test_open_surfaces_separate() -> None:
    """Only the inner faces of the walls."""
    triangles = ring()
    inner = triangles[(np.abs(np.abs(triangles[:, :, :2]) - 10) < 1e-9).all(axis=1).any(axis=1)]
    assert len(inner) < len(triangles)
    assert not connected(Waters(inner, HULL), (0, 0), (15, 0))


def test_open_water_is_one_region() -> None:
    assert connected(Waters(walls(((0, 0, 3.0), (9, 9, 4.0))), HULL), (4, 4), (50, 50))


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_a_boat_that_moves_without_touching_anything_stays_in_one_region(seed: int) -> None:
    """Random boxes and turns, and hulls longer and shorter than wide."""
    rng = np.random.default_rng(seed)
    hull = Hull(length_m=rng.uniform(0.5, 3), beam_m=rng.uniform(0.4, 2))
    low = rng.uniform(-8, 8, (12, 2))
    high = low + rng.uniform(0.1, 4, (12, 2))
    bodies = [box((*a, -1.0), (*b, 1.0)) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    part = Part("boxes", "mesh", tuple(Solid("mesh", trimesh.Trimesh(b.vertices, b.faces)) for b in bodies))
    checker = CollisionChecker(assemble("boxes", [part]), hull)
    pose = rng.uniform(-9, 9, 3)
    while checker.blocked(pose[None])[0]:
        pose = rng.uniform(-9, 9, 3)
    path = [pose]
    for step in rng.normal(size=(150, 3)) * [0.15, 0.15, 0.3]:
        if not checker.blocked((path[-1] + step)[None])[0]:
            path.append(path[-1] + step)
    assert not checker.unreachable(np.array(path), pose).any()


def test_blocked_poses_are_not_reachable_from_themselves() -> None:
    part = Part("quay", "quay", (Solid("quay", box((0, 0, -1), (4, 4, 1))),))
    checker = CollisionChecker(assemble("quay", [part]), HULL)
    inside, outside = np.array([2.0, 2.0, 0.0]), np.array([9.0, 9.0, 0.0])
    assert checker.unreachable(np.array([inside, outside]), outside).tolist() == [True, False]
    assert checker.unreachable(np.array([inside]), inside).tolist() == [True]
