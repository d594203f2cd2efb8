"""The grid of starts of a success map."""

from __future__ import annotations

import pytest

from dockctl.evaluation import Grid


@pytest.mark.parametrize(
    ("reach", "step", "places"),
    [
        (10, 2, [-10, -8, -6, -4, -2, 0, 2, 4, 6, 8, 10]),
        (0.3, 0.1, [-0.3, -0.2, -0.1, 0, 0.1, 0.2, 0.3]),
        (5, 2, [-4, -2, 0, 2, 4]),
        (1, 2, [0]),
        (0, 1, [0]),
    ],
)
def test_the_reference_pose_is_on_the_grid(reach: float, step: float, places: list[float]) -> None:
    grid = Grid(reach, step, (0, 90))
    assert grid.positions_m == pytest.approx(places)
    offsets = grid.offsets(90.0)
    assert offsets.shape == (len(places) ** 2, 3)
    assert len({tuple(row) for row in offsets}) == len(offsets)
    assert (offsets[len(offsets) // 2] == (0, 0, 90)).all()
