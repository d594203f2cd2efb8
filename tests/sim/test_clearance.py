"""The minimum clearance of a trajectory against the clearances of all its poses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.solids import hull_mesh
from dockctl.sim.swept import least_clearance

PILES = np.array([[0.0, 0.0], [3.0, 1.0], [-2.0, 4.0]])
KEEL = np.array([[-1.5, 0.0], [0.0, 0.3], [1.5, 0.0]])


def gap(eta: Floats) -> Floats:
    """Distance between three points of a boat and three piles, (m, 3) to (m,)."""
    cosine, sine = np.cos(eta[:, 2]), np.sin(eta[:, 2])
    turn = np.stack([np.stack([cosine, -sine], 1), np.stack([sine, cosine], 1)], 1)
    points = eta[:, None, :2] + KEEL @ turn.transpose(0, 2, 1)
    distances: Floats = np.linalg.norm(points[:, :, None] - PILES, axis=-1).min(axis=(1, 2))
    return distances


@given(seed=st.integers(0, 10_000), length=st.integers(1, 60), pace=st.floats(0, 1))
def test_it_is_the_minimum_over_all_poses(seed: int, length: int, pace: float) -> None:
    rng = np.random.default_rng(seed)
    trajectory = np.cumsum(rng.normal(size=(length, 3)) * pace, axis=0) + rng.normal(size=3) * 5
    assert least_clearance(trajectory, gap, 1.5) == gap(trajectory).min()


def test_few_poses_are_evaluated() -> None:
    evaluated = []

    def counting(eta: Floats) -> Floats:
        evaluated.append(len(eta))
        return gap(eta)

    trajectory = np.linspace([10, 0, 0], [1.8, 0, 0.4], 400)
    assert least_clearance(trajectory, counting, 1.5) == gap(trajectory).min()
    assert sum(evaluated) < 40


def test_reach_of_the_hull() -> None:
    for hull in (Hull(), Hull(length_m=1.0, beam_m=3.0)):
        assert hull.reach_m == pytest.approx(np.hypot(*hull_mesh(hull).vertices[:, :2].T).max())
