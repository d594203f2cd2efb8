"""Cells, curves and marks of the success map."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.patches import Circle

from dockctl.analysis.success_map import free_starts
from dockctl.drawing import palette
from dockctl.reports.style import figure_style, make_axes
from dockctl.reports.success_map import draw_by_distance, draw_by_heading, draw_cells, map_figure
from dockctl.scenarios.schema import Task, Tolerance
from tests.reports.synthetic import FINAL, OFFSETS, marina, success_map

TASK = Task.model_validate(
    {
        "initial": [{"x_m": 20, "y_m": 2, "heading_deg": 160}],
        "final": FINAL,
        "final_tolerance": Tolerance(distance_m=1, heading_deg=4, speed_mps=0.1),
    }
)


def test_one_cell_per_start_in_the_color_of_its_outcome() -> None:
    table = success_map(failing={(2.0, 2.0), (4.0, 0.0)}, blocked={(-4.0, -4.0)})
    with figure_style():
        _, ax = make_axes("", "")
        draw_cells(ax, table, marina().hull, 4.0)
    counts = {
        to_hex(cells.get_facecolor()[0]): len(cells.get_paths())
        for cells in ax.collections
        if len(cells.get_paths()) and not cells.get_hatch()
    }
    assert counts == {palette.DOCKED.lower(): 22, palette.TIMEOUT.lower(): 2}
    assert [len(cells.get_paths()) for cells in ax.collections if cells.get_hatch()] == [1]
    (circle,) = [patch for patch in ax.patches if isinstance(patch, Circle)]
    assert circle.get_radius() == 2.0


@pytest.mark.parametrize("headings", [(0.0,), (0.0, 45.0, -45.0, 90.0, 180.0)])
def test_one_panel_per_heading_offset_with_its_numbers(headings: tuple[float, ...]) -> None:
    table = success_map(failing={(0.0, 4.0)}, blocked={(4.0, 4.0)}, headings=headings)
    with figure_style():
        figure = map_figure(table, marina(), TASK, "caption")
        figure.draw_without_rendering()
    panels = [ax for sub in figure.subfigs for ax in sub.axes if ax.get_visible()]
    assert len(panels) == len(headings) + 2
    assert all("23 of 24" in ax.get_title(loc="left") for ax in panels[: len(headings)])
    text = " ".join(text.get_text() for text in figure.texts)
    assert "(20, 2, 160°)" in text
    assert "96%" in text and "2.83 m" in text


def test_success_by_distance_and_heading() -> None:
    free = free_starts(success_map(failing={(0.0, 4.0), (0.0, 2.0)}, headings=(0.0, 90.0)))
    with figure_style():
        _, by_distance = make_axes("", "")
        draw_by_distance(by_distance, free, 4.0)
        _, by_heading = make_axes("", "")
        draw_by_heading(by_heading, free)
    curve = by_distance.lines[0]
    assert np.asarray(curve.get_xdata(), float).tolist() == [0.0, 2.0, 4.0]
    assert np.asarray(curve.get_ydata(), float).tolist() == pytest.approx([1, 7 / 8, 11 / 12])
    assert np.asarray(by_heading.lines[0].get_xdata(), float).tolist() == [0.0, 90.0]
    legend = by_heading.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["within 3 m", "within 5.66 m"]


@pytest.mark.parametrize("failing", [set(OFFSETS), set()])
def test_the_subtitle_mentions_dashed_circles_only_where_they_are_drawn(
    failing: set[tuple[float, float]],
) -> None:
    with figure_style():
        figure = map_figure(success_map(failing=failing), marina(), TASK, "caption")
        figure.draw_without_rendering()
    circles = [p for sub in figure.subfigs for ax in sub.axes for p in ax.patches if isinstance(p, Circle)]
    text = " ".join(text.get_text() for text in figure.texts)
    assert ("dashed" in text) == bool(circles) == (not failing)
