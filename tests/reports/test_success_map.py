"""The map of starts: what counts, the success radius, and what is drawn."""

from __future__ import annotations

import itertools
from collections.abc import Set as AbstractSet
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_hex

from dockctl.analysis.success_map import free_starts, half_width, success_radius, within_heading
from dockctl.drawing import palette
from dockctl.reports.style import house_style, save, titled_axes
from dockctl.reports.success_map import draw_cells, map_figure
from dockctl.scenarios.schema import Task, Tolerance
from tests.reports.synthetic import FINAL, marina

TASK = Task.model_validate(
    {
        "initial": [{"x_m": 20, "y_m": 2, "heading_deg": 160}],
        "final": FINAL,
        "final_tolerance": Tolerance(distance_m=1, heading_deg=4, speed_mps=0.1),
    }
)
OFFSETS = [(dx, dy) for dx in (-4.0, -2.0, 0.0, 2.0, 4.0) for dy in (-4.0, -2.0, 0.0, 2.0, 4.0)]


def starts(
    failing: AbstractSet[tuple[float, float]] = frozenset(),
    blocked: AbstractSet[tuple[float, float]] = frozenset(),
    headings: tuple[float, ...] = (0.0,),
) -> pd.DataFrame:
    """A map on which all but some starts dock, the same ones for each heading."""
    return pd.DataFrame(
        {
            "dx_m": dx,
            "dy_m": dy,
            "dheading_deg": heading,
            "x_m": 20 + dx,
            "y_m": 2 + dy,
            "heading_deg": 160 + heading,
            "blocked": int((dx, dy) in blocked),
            "outcome": np.nan if (dx, dy) in blocked else "timeout" if (dx, dy) in failing else "docked",
        }
        for heading, (dx, dy) in itertools.product(headings, OFFSETS)
    )


@pytest.mark.parametrize(
    ("failing", "blocked", "radius"),
    [
        (set(), set(), 4.0),  # the corners are farther, but the map does not reach so far on all sides
        ({(4.0, 4.0)}, set(), 4.0),
        ({(-4.0, 0.0)}, set(), 8**0.5),
        ({(2.0, 2.0), (0.0, 4.0)}, set(), 2.0),
        ({(0.0, 2.0)}, set(), 0.0),
        ({(0.0, 0.0)}, set(), None),
        ({(4.0, 4.0)}, {(0.0, 2.0)}, 4.0),  # a blocked start does not count
        (set(), {(0.0, 0.0)}, None),
    ],
)
def test_the_success_radius(
    failing: set[tuple[float, float]], blocked: set[tuple[float, float]], radius: float | None
) -> None:
    found = success_radius(free_starts(starts(failing, blocked)), 4.0)
    assert found == (None if radius is None else pytest.approx(radius))


@given(st.sets(st.sampled_from(OFFSETS)), st.sets(st.sampled_from(OFFSETS)))
def test_every_free_start_within_the_radius_docks(
    failing: set[tuple[float, float]], blocked: set[tuple[float, float]]
) -> None:
    table = starts(failing, blocked)
    radius = success_radius(free_starts(table), 4.0)
    distance = np.hypot(table["dx_m"], table["dy_m"])
    free = table["blocked"] == 0
    if radius is None:
        assert (0.0, 0.0) in failing | blocked
    else:
        assert (table["outcome"][free & (distance <= radius + 1e-9)] == "docked").all()
        next_one = distance[free & (distance > radius + 1e-9)].min()  # what stops it: a failure or the edge
        assert (
            not next_one <= 4.0
            or not (table["outcome"][free & (distance <= next_one + 1e-9)] == "docked").all()
        )


def test_blocked_starts_are_no_failures() -> None:
    free = free_starts(starts(failing={(2.0, 0.0)}, blocked={(4.0, 0.0), (4.0, 2.0)}))
    assert (len(free), free["docked"].sum()) == (23, 22)


def test_headings_are_grouped_by_their_size() -> None:
    free = free_starts(starts(headings=(0.0, 20.0, -20.0, 180.0)))
    assert set(within_heading(free, 20)["dheading_deg"]) == {0.0, 20.0, -20.0}
    assert half_width(free) == 4.0


def test_a_cell_a_start_in_the_color_of_its_outcome() -> None:
    table = starts(failing={(2.0, 2.0), (4.0, 0.0)}, blocked={(-4.0, -4.0)})
    with house_style():
        _, ax = titled_axes("", "")
        draw_cells(ax, table, marina().hull, 4.0)
    counts = {
        to_hex(cells.get_facecolor()[0]): len(cells.get_paths())
        for cells in ax.collections
        if len(cells.get_paths()) and not cells.get_hatch()
    }
    assert counts == {palette.DOCKED.lower(): 22, palette.TIMEOUT.lower(): 2}
    assert [len(cells.get_paths()) for cells in ax.collections if cells.get_hatch()] == [1]


@pytest.mark.parametrize("headings", [(0.0,), (0.0, 45.0, -45.0, 90.0, 180.0)])
def test_the_figure_tells_headings_numbers_and_radius(headings: tuple[float, ...], tmp_path: Path) -> None:
    table = starts(failing={(0.0, 4.0)}, blocked={(4.0, 4.0)}, headings=headings)
    with house_style():
        figure = map_figure(table, marina(), TASK, "policy of made-up, seed 3")
        written = save({"map": figure}, tmp_path)
    assert all(path.stat().st_size > 10_000 for path in written)
    panels = [ax.get_title(loc="left") for sub in figure.subfigs for ax in sub.axes if ax.get_visible()]
    assert panels[: len(headings)] == [
        f"{name}   23 of 24"
        for name in (
            "heading of the pose", "turned by +45°", "turned by −45°", "turned by +90°", "turned by 180°",
        )[: len(headings)]
    ]  # fmt: skip
    words = " ".join(text.get_text() for text in figure.texts)
    assert "starts within ±4 m of (20, 2, 160°)" in words
    assert "96%" in words and "2.83 m with the heading of the pose" in words


def test_a_map_without_a_docking_start_is_drawn(tmp_path: Path) -> None:
    with house_style():
        figure = map_figure(starts(failing=set(OFFSETS)), marina(), TASK, "policy")
        assert save({"map": figure}, tmp_path)
    assert "none with the heading" in " ".join(text.get_text() for text in figure.texts)
