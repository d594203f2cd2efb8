"""Approximate clearances against exact ones, and against a box."""

from __future__ import annotations

import numpy as np
import pytest

from dockctl.geometry import Floats
from dockctl.scenarios.loader import load
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.distances import DistanceField
from dockctl.sim.harbor.solids import box
from dockctl.sim.world import build_worlds

SLENDER = Hull(length_m=3, beam_m=1, draft_m=0.3, freeboard_m=0.5)
QUAY = box((0, -20, -2), (10, 20, 1)).triangles


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ((-2.0, 0.0, 0.0), 0.5),  # the bow is 1.5 m ahead
        ((-1.2, 0.0, np.pi / 2), 0.7),  # beside the quay, half a beam away
        ((-2.5, 15.0, np.pi), 1.0),
        ((-9.0, 0.0, 0.0), 1.0),  # beyond the grid
    ],
)
def test_before_a_quay(pose: tuple[float, float, float], expected: float) -> None:
    assert DistanceField(QUAY, SLENDER).clearance(np.array([pose])) == pytest.approx([expected], abs=0.06)


def test_what_is_farther_than_the_map_reaches_is_infinitely_far() -> None:
    quays = np.concatenate([QUAY, box((-30, -20, -2), (-20, 20, 1)).triangles])
    ahead_m = np.array([3.0, 3.1, 3.3, 8.5])
    found = DistanceField(quays, SLENDER).clearance(np.array([(-1.5 - gap, 0.0, 0.0) for gap in ahead_m]))
    assert found[:2] == pytest.approx(ahead_m[:2], abs=0.06)
    assert np.isinf(found[2:]).all()


def test_a_hull_on_the_edge_of_a_quay_has_no_clearance() -> None:
    astride = np.array([[0.2, 0.0, heading] for heading in np.linspace(0, 3, 20)])
    assert (DistanceField(QUAY, SLENDER).clearance(astride) < 0.15).all()


def test_what_passes_above_the_hull_is_no_obstacle() -> None:
    bridge = box((0, -20, 1), (10, 20, 2)).triangles
    assert DistanceField(bridge, SLENDER).clearance(np.zeros((1, 3))) == np.inf


def test_in_a_marina_it_is_about_the_exact_clearance() -> None:
    scenario = load("s3").scenario
    (world,) = build_worlds(scenario, load("s3").base_dir)
    rng = np.random.default_rng(0)
    poses: Floats = rng.uniform((-15, -15, -np.pi), (35, 15, np.pi), (600, 3))
    exact = world.obstacles.clearance_below(poses, 0.9)
    free = (exact > 0) & (exact < 0.9)
    assert free.sum() > 50
    found = world.obstacles.approximate_clearance(poses)
    error = found[free] - exact[free]
    assert np.abs(error).max() < 0.2
    assert np.abs(error).mean() < 0.05
    stacked = world.obstacles.approximate_clearance(poses.reshape(20, 30, 3))
    np.testing.assert_array_equal(stacked.ravel(), found)
