"""Time series show the numbers of the tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes

from dockctl.reports import trajectory
from dockctl.reports.figures import DrawTracks
from dockctl.reports.plan_view import split_tracks
from dockctl.reports.style import figure_style, make_axes
from dockctl.scenarios.schema import Task
from tests.reports import synthetic

TASK = Task.model_validate(
    {"initial": [synthetic.FINAL], "intermediate": synthetic.INTERMEDIATE, "final": synthetic.FINAL}
)
STARTS = [(20.0, 3.0, 150.0), (20.0, 2.0, 160.0), (20.0, -1.5, 190.0)]


@pytest.fixture
def ax() -> Iterator[Axes]:
    with figure_style():
        yield make_axes("", "")[1]


@pytest.fixture
def three() -> pd.DataFrame:
    return pd.concat([synthetic.track(i, start) for i, start in enumerate(STARTS)])


@pytest.fixture
def two_phases() -> pd.DataFrame:
    return synthetic.track(0, (23.0, -10.0, 90.0), intermediate=True, steps=20)


@pytest.mark.parametrize(
    ("draw", "columns", "unit"),
    [
        (trajectory.draw_distance, ["distance_m"], "[m]"),
        (trajectory.draw_heading_error, ["heading_error_deg"], "[°]"),
        (trajectory.draw_velocity, ["u_mps", "v_mps"], "[m/s]"),
        (trajectory.draw_yaw_rate, ["r_degps"], "[°/s]"),
        (trajectory.draw_propeller, ["propeller_n"], "[N]"),
        (trajectory.draw_rudder, ["rudder_deg"], "[°]"),
    ],
)
def test_lines_are_the_columns(
    ax: Axes, three: pd.DataFrame, draw: DrawTracks, columns: list[str], unit: str
) -> None:
    tracks = split_tracks(three)
    draw(ax, tracks, TASK)
    drawn = {str(line.get_label()): line for line in ax.lines}
    for track in tracks:
        for column in columns:
            line = drawn[f"{track.label} {column}"]
            assert np.array_equal(line.get_xdata(), track.table["time_s"])
            assert np.array_equal(line.get_ydata(), track.table[column])
            assert line.get_color() == track.color
    assert unit in ax.get_ylabel()
    assert ax.get_xlabel() == "Time [s]"


def test_times_may_be_whole_numbers(ax: Axes, three: pd.DataFrame) -> None:
    """As pandas reads those of a control period of 1 s; one of the tracks has a single row."""
    whole = three.assign(time_s=(2 * three["time_s"]).round().astype(int))
    first, *others = split_tracks(whole)
    single = replace(first, table=first.table.iloc[:1])
    trajectory.draw_propeller(ax, [single, *others], TASK)
    assert len(ax.lines) >= 3


def test_commands_are_steps_that_end_at_their_row(ax: Axes, three: pd.DataFrame) -> None:
    trajectory.draw_propeller(ax, split_tracks(three), TASK)
    assert {line.get_drawstyle() for line in ax.lines[:3]} == {"steps-pre"}


def test_no_line_connects_two_goals(ax: Axes, two_phases: pd.DataFrame) -> None:
    trajectory.draw_distance(ax, split_tracks(two_phases), TASK)
    values = np.asarray(ax.lines[0].get_ydata(), float)
    assert np.flatnonzero(np.isnan(values)).tolist() == [20]
    assert np.array_equal(np.delete(values, 20), two_phases["distance_m"])


def test_no_line_crosses_the_wrap_of_the_heading(ax: Axes, three: pd.DataFrame) -> None:
    turning = three[three["pose"] == 0].copy()
    errors = np.linspace(170, 190, len(turning))
    turning["heading_error_deg"] = np.where(errors > 180, errors - 360, errors)
    trajectory.draw_heading_error(ax, split_tracks(turning), TASK)
    values = np.asarray(ax.lines[0].get_ydata(), float)
    assert np.isnan(values).sum() == 1
    assert np.nanmax(np.abs(np.diff(values))) < 1


def test_the_tolerance_follows_the_phase(ax: Axes, two_phases: pd.DataFrame) -> None:
    trajectory.draw_distance(ax, split_tracks(two_phases), TASK)
    assert {text.get_text() for text in ax.texts} == {"tolerance 1.5 m", "tolerance 1 m"}
    trajectory.mark_phases(ax, split_tracks(two_phases))
    assert {"to the intermediate pose", "to the berth"} <= {text.get_text() for text in ax.texts}


def test_the_tolerance_of_a_boat_that_never_reaches_the_intermediate_pose(
    ax: Axes, two_phases: pd.DataFrame
) -> None:
    trajectory.draw_distance(ax, split_tracks(two_phases[two_phases["phase"] == 0]), TASK)
    band = np.asarray(ax.collections[0].get_paths()[0].vertices)
    assert band[:, 1].max() == TASK.intermediate_tolerance.distance_m


def test_long_command_sequences_have_their_mean(ax: Axes) -> None:
    table = synthetic.track(0, STARTS[0], steps=600)
    trajectory.draw_propeller(ax, split_tracks(table), TASK)
    raw, mean = ax.lines[0], ax.lines[1]
    assert np.array_equal(raw.get_ydata(), table["propeller_n"])
    half = trajectory.MEAN_STEPS // 2
    middle = table["propeller_n"].to_numpy()[100 - half : 100 + half]
    assert np.asarray(mean.get_ydata())[100] == pytest.approx(middle.mean())
    assert raw.get_linewidth() < mean.get_linewidth()


def test_steps_are_as_narrow_as_the_shared_time_axis_makes_them(ax: Axes) -> None:
    table = synthetic.track(0, STARTS[0], steps=100)
    ax.set_xlim(0, 300)
    trajectory.draw_propeller(ax, split_tracks(table), TASK)
    assert any("mean" in str(line.get_label()) for line in ax.lines)
    assert ax.get_xlim() == (0, 300)
