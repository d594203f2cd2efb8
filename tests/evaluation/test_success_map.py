"""The grid of starts of a success map."""

from __future__ import annotations

import math

import pytest

from dockctl.errors import DockctlError
from dockctl.evaluation import Grid, success_map


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


@pytest.mark.parametrize(
    ("reach", "step"),
    [
        (-1.0, 1.0),
        (math.nan, 1.0),
        (math.inf, 1.0),
        (1.0, 0.0),
        (1.0, -1.0),
        (1.0, math.nan),
        (1.0, math.inf),
        (1e9, 1e-4),
        (1e300, 1e-300),
    ],
)
def test_a_grid_of_no_or_too_large_a_size_is_an_error(reach: float, step: float) -> None:
    with pytest.raises(DockctlError) as caught:
        Grid(reach, step)
    assert caught.value.code == "out_of_range"


def test_a_grid_without_headings_is_an_error() -> None:
    with pytest.raises(DockctlError, match="one or more different directions"):
        Grid(1.0, 1.0, ())


def test_each_start_has_its_own_weather_for_every_policy() -> None:
    """With two headings at nine positions, the 18 draws differ, and a second map repeats them."""
    weather = ("conditions.wind={speed_mps: [0, 5], direction_deg: [0, 360]}", "task.max_steps=1")
    first, second = (
        success_map(policy, "s1", Grid(1, 1, (0, 20)), overrides=weather).table for policy in ("s1", "s2")
    )
    speeds = first["wind_speed_mps"]
    assert len(speeds) == 18 and speeds.nunique() == len(speeds)
    assert speeds.tolist() == second["wind_speed_mps"].tolist()
