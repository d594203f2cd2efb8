"""Plan view: harbor, views, tracks and poses."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from dockctl.drawing import palette
from dockctl.drawing.scene import OPEN_WATER_M, Scene, strokes, water
from dockctl.geometry import to_world
from dockctl.reports import plan_view
from dockctl.reports.plan_view import Track, split_tracks
from dockctl.reports.style import figure_style, make_axes
from dockctl.scenarios.schema import Task
from tests.reports import synthetic

TASK = Task.model_validate(
    {
        "initial": [{"x_m": 23, "y_m": -10, "heading_deg": 90}],
        "intermediate": synthetic.INTERMEDIATE,
        "final": synthetic.FINAL,
    }
)
PLAN = synthetic.marina()
STARTS = [(20.0, 3.0, 150.0), (20.0, 2.0, 160.0), (20.0, -1.5, 190.0)]


def timed(seconds: float) -> Track:
    return Track("", "red", pd.DataFrame({"time_s": [0.0, seconds]}))


def test_shadows_are_drawn_first() -> None:
    drawn = list(strokes(PLAN))
    solids = [polygon for polygon in PLAN.polygons if polygon.kind in ("quay", "finger", "hull")]
    assert all(stroke.edge is None for stroke in drawn[: len(solids)])
    assert np.array_equal(drawn[len(solids)].xy, PLAN.polygons[0].xy)
    planks = [stroke for stroke in drawn if stroke.fill is None]
    assert len(planks) == 7 * 15  # 8 m piers, a line every half meter
    assert all(np.ptp(plank.xy[:, 0]) == 0 and np.ptp(plank.xy[:, 1]) == 1 for plank in planks)


def test_open_water_around_a_harbor_without_quays() -> None:
    assert water(PLAN) == PLAN.bounds
    bare = replace(PLAN, polygons=tuple(p for p in PLAN.polygons if p.kind != "quay"))
    assert water(bare)[0] == PLAN.bounds[0] - OPEN_WATER_M


@given(
    st.lists(st.tuples(st.floats(5, 38), st.floats(-39, 39)), min_size=1, max_size=5),
    st.sampled_from([(0.85, 1.75), (1.0, 1.0), (1.3, 1.3)]),
)
def test_a_view_contains_its_points_and_is_inside_the_harbor(
    points: list[tuple[float, float]], aspect: tuple[float, float]
) -> None:
    x0, y0, x1, y1 = plan_view.close_view(PLAN, np.array(points), aspect=aspect)
    assert all(x0 <= x <= x1 and y0 <= y <= y1 for x, y in points)
    low_x, low_y, high_x, high_y = plan_view.whole_view(PLAN)
    assert low_x - 1e-9 <= x0
    assert low_y - 1e-9 <= y0
    assert x1 <= high_x + 1e-9
    assert y1 <= high_y + 1e-9


def test_bounds_are_extended_to_poses_outside() -> None:
    assert plan_view.extended(PLAN, np.array([[20.0, 0.0]])) is PLAN
    extended = plan_view.extended(PLAN, np.array([[20.0, 0.0], [60.0, -50.0]]))
    assert extended.bounds == (4.5, -50.0, 60.0, 40.0)


@pytest.mark.parametrize(
    ("seconds", "interval"), [(9.0, 1.0), (40.0, 5.0), (60.0, 5.0), (250.0, 50.0), (5000.0, 100.0)]
)
def test_outlines_are_at_round_intervals(seconds: float, interval: float) -> None:
    assert plan_view.outline_interval([timed(1.0), timed(seconds)]) == interval


def test_paths_and_outlines_are_those_of_the_table() -> None:
    with figure_style():
        _, ax = make_axes("", "")
        tracks = split_tracks(synthetic.track(0, (23.0, -10.0, 90.0), intermediate=True))
        plan_view.draw_paths(ax, PLAN, tracks, TASK)
    table = tracks[0].table
    path = np.asarray(ax.lines[0].get_xydata())
    assert np.array_equal(path, table[["x_m", "y_m"]])
    starts = to_world(PLAN.hull, np.array([23.0, -10.0, math.pi / 2]))
    outlines = [
        np.asarray(patch.get_xy())
        for patch in ax.patches
        if hasattr(patch, "get_xy") and np.ndim(patch.get_xy()) == 2
    ]
    assert any(xy[:-1] == pytest.approx(starts) for xy in outlines)
    shown = table[np.isclose(table["time_s"] % 10, 0)]
    for _, row in shown.iterrows():
        pose = np.array([row["x_m"], row["y_m"], math.radians(row["heading_deg"])])
        assert any(xy[:-1] == pytest.approx(to_world(PLAN.hull, pose)) for xy in outlines)


def test_tolerances_are_circles_around_the_goals() -> None:
    with figure_style():
        _, ax = make_axes("", "")
        plan_view.draw_poses(ax, PLAN, TASK, ())
    circles = {(circle.center, circle.radius) for circle in ax.patches if isinstance(circle, Circle)}
    assert circles == {((36.0, 0.0), 1.0), ((18.0, 3.0), 1.5)}
    assert {text.get_text() for text in ax.texts} == {"berth", "intermediate pose", "start"}


@pytest.mark.parametrize(
    ("phases", "expected"),
    [
        ([[0, 0, 1], [0, 1, 1]], [(None, 2.0, 1.5), (1.0, None, 1.0)]),
        ([[0, 0, 0]], [(None, None, 1.5)]),
        ([[1, 1, 1]], [(None, None, 1.0)]),
    ],
)
def test_the_tolerances_are_those_of_the_phases(phases: list[list[int]], expected: list[Any]) -> None:
    """Also before the first episode has reached the intermediate pose."""
    tracks = [Track("", "", pd.DataFrame({"time_s": [0.0, 1.0, 2.0], "phase": phase})) for phase in phases]
    spans = plan_view.tolerance_spans(tracks, TASK)
    assert [(start, end, tolerance.distance_m) for start, end, tolerance in spans] == expected


def test_the_harbor_is_drawn_to_scale() -> None:
    with figure_style():
        _, ax = make_axes("", "")
        view = plan_view.whole_view(PLAN)
        plan_view.draw_harbor(ax, PLAN, view)
        plan_view.draw_compass(ax, view)
    assert ax.get_aspect() == 1.0
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]")
    assert [text.get_text() for text in ax.texts] == ["5 m", "N"]
    assert len(ax.collections[0].get_paths()) == len(list(strokes(PLAN)))


def test_intervals_are_sorted() -> None:
    assert all(a < b for a, b in pairwise(plan_view.INTERVALS_S))


def test_scene_json_round_trip() -> None:
    again = Scene.from_json(PLAN.to_json())
    assert len(list(strokes(again))) == len(list(strokes(PLAN)))


def test_labels_and_colors_of_tracks() -> None:
    three = pd.concat([synthetic.track(i, start) for i, start in enumerate(STARTS)])
    tracks = split_tracks(three)
    assert [track.label for track in tracks] == ["(20, 3, 150°)", "(20, 2, 160°)", "(20, −1.5, 190°)"]
    assert [track.color for track in tracks] == [palette.RED, palette.GREEN, palette.BLUE]
    assert all(len(track.table) == len(three) / 3 for track in tracks)


def test_a_single_track() -> None:
    (track,) = split_tracks(synthetic.track(0, (23.0, -10.0, 90.0), intermediate=True, steps=20))
    assert track.docked
    assert track.color == palette.SINGLE
    assert track.switch == 20


def test_the_mean_current_and_wind_of_a_trajectory_are_arrows() -> None:
    ax = Figure().subplots()
    plan_view.draw_flows(ax, plan_view.mean_flows(pd.DataFrame({"x_m": [0.0, 1.0]})))
    assert not ax.texts
    table = pd.DataFrame({"wind_x_mps": [0.0, 0.0], "wind_y_mps": [-2.0, -4.0]})
    plan_view.draw_flows(ax, plan_view.mean_flows(table))
    arrow, label = ax.texts
    assert label.get_text() == "wind 3 m/s"
    assert arrow.get_position()[1] > 0  # the foot is above the head: it blows towards -y


def test_several_trajectories_have_arrows_of_what_they_have_in_common() -> None:
    tables = [
        pd.DataFrame({"current_x_mps": [x] * 3, "current_y_mps": 0.0, "wind_x_mps": 2.0, "wind_y_mps": 0.0})
        for x in (0.1, 0.2)
    ]
    assert plan_view.common_flows(tables) == {"wind": (2.0, 0.0)}
    assert plan_view.common_flows(tables[:1]) == {"current": (pytest.approx(0.1), 0.0), "wind": (2.0, 0.0)}
    two = split_tracks(pd.concat([synthetic.track(i, (20.0, 2.0 * i, 160.0)) for i in range(2)]))
    for track in two:
        track.table[["wind_x_mps", "wind_y_mps"]] = 2.0, 0.0
    ax = Figure().subplots()
    plan_view.draw_paths(ax, PLAN, two, TASK)
    assert "wind 2 m/s" in [text.get_text() for text in ax.texts]
