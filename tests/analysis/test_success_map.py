"""Success radius and selections of starts."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.analysis.success_map import (
    free_starts,
    half_width,
    success_radius,
    within_distance,
    within_heading,
)
from tests.reports.synthetic import OFFSETS, success_map


@pytest.mark.parametrize(
    ("failing", "blocked", "radius"),
    [
        (set(), set(), 4.0),  # the corners are farther, but the map is a square
        ({(4.0, 4.0)}, set(), 4.0),
        ({(-4.0, 0.0)}, set(), 8**0.5),
        ({(2.0, 2.0), (0.0, 4.0)}, set(), 2.0),
        ({(0.0, 2.0)}, set(), 0.0),
        ({(0.0, 0.0)}, set(), None),
        ({(4.0, 4.0)}, {(0.0, 2.0)}, 4.0),  # a blocked start does not count
        (set(), {(0.0, 0.0)}, None),
    ],
)
def test_success_radius(
    failing: set[tuple[float, float]], blocked: set[tuple[float, float]], radius: float | None
) -> None:
    found = success_radius(free_starts(success_map(failing, blocked)), 4.0)
    assert found == (None if radius is None else pytest.approx(radius))


@given(st.sets(st.sampled_from(OFFSETS)), st.sets(st.sampled_from(OFFSETS)))
def test_every_free_start_within_the_radius_docks(
    failing: set[tuple[float, float]], blocked: set[tuple[float, float]]
) -> None:
    table = success_map(failing, blocked)
    radius = success_radius(free_starts(table), 4.0)
    distance = np.hypot(table["dx_m"], table["dy_m"])
    free = table["blocked"] == 0
    if radius is None:
        assert (0.0, 0.0) in failing | blocked
    else:
        assert (table["outcome"][free & (distance <= radius + 1e-9)] == "docked").all()
        next_one = distance[free & (distance > radius + 1e-9)].min()  # a failure, or the edge
        assert (
            not next_one <= 4.0
            or not (table["outcome"][free & (distance <= next_one + 1e-9)] == "docked").all()
        )


def test_blocked_starts_do_not_count() -> None:
    free = free_starts(success_map(failing={(2.0, 0.0)}, blocked={(4.0, 0.0), (4.0, 2.0)}))
    assert (len(free), free["docked"].sum()) == (23, 22)


def test_starts_within_limits() -> None:
    free = free_starts(success_map(headings=(0.0, 20.0, -20.0, 180.0)))
    assert set(within_heading(free, 20)["dheading_deg"]) == {0.0, 20.0, -20.0}
    assert half_width(free) == 4.0
    assert within_distance(free, 2)["offset_m"].max() == 2.0
