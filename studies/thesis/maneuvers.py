"""Figures of greedy episodes: trajectories over the harbor, motion and controls over time."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure

from dockctl.drawing import palette
from dockctl.drawing.scene import Scene
from dockctl.reports import plan_view, trajectory
from dockctl.reports.plan_view import Track
from dockctl.reports.style import legend_above, make_axes, make_figure, panel_title, panels
from dockctl.scenarios.schema import Task
from dockctl.scenarios.vessel import Vessel
from studies.thesis.data import ArchivedRun, Recording

MOTIONS = (
    trajectory.draw_distance,
    trajectory.draw_heading_error,
    trajectory.draw_velocity,
    trajectory.draw_yaw_rate,
)
TITLED_IN = 8.5
"""Minimum width of a figure, for its title [inches]."""
CONTROLS = ((trajectory.draw_propeller, "P [N]"), (trajectory.draw_rudder, "φ [°]"))


def by_seed(recordings: Sequence[tuple[int, Recording]]) -> list[Track]:
    """The first track of every seed, named and colored by seed."""
    return [
        Track(f"seed {seed}", palette.SERIES[seed % len(palette.SERIES)], recording.tracks[0].table)
        for seed, recording in recordings
    ]


def maneuver_figure(
    title: str, subtitle: str, plan: Scene, task: Task, tracks: Sequence[Track], cited: Sequence[str]
) -> Figure:
    """Pose, distance, heading error, velocities and controls (as Figs. 4.4-4.10).

    Args:
        cited: the seven figures of the thesis, in its order.
    """
    lower_height = 0.55 + 0.85 * len(tracks)
    figure = make_figure(title, subtitle, (13.0, 7.6 + lower_height))
    rows = figure.add_gridspec(2, 1, height_ratios=(6.9, lower_height))
    upper, lower = figure.add_subfigure(rows[0]), figure.add_subfigure(rows[1])
    columns = upper.add_gridspec(1, 2, width_ratios=(1.0, 1.12))
    left, right = upper.add_subfigure(columns[0]), upper.add_subfigure(columns[1])
    draw_trajectories(left.add_subplot(), plan, task, tracks, cited[0])
    for ax, draw, number in zip(right.subplots(2, 2).ravel(), MOTIONS, cited[1:5], strict=True):
        with mpl.rc_context({"lines.linewidth": 1.1 if len(tracks) > 1 else 1.6}):
            draw(ax, tracks, task)
        if (legend := ax.get_legend()) and len(tracks) > 1:
            legend.remove()  # the trajectories have the same colors
        _cite(ax, number)
    _draw_controls(lower, tracks, task, cited[5:])
    return figure


def draw_trajectories(ax: Axes, plan: Scene, task: Task, tracks: Sequence[Track], number: str) -> None:
    """Trajectories over the part of the harbor that they are in."""
    paths = [track.table[["x_m", "y_m"]].to_numpy(float) for track in tracks]
    points = np.concatenate([*paths, plan_view.task_points(task)])
    whole = plan_view.extended(plan, points)
    view = plan_view.close_view(whole, points, aspect=(0.9, 0.98))
    plan_view.draw_harbor(ax, whole, view)
    plan_view.draw_paths(ax, whole, tracks, task)
    legend_above(ax, [(track.label, track.color) for track in tracks], columns=3)
    plan_view.draw_compass(ax, view)
    _cite(ax, number)


def trajectories_figure(title: str, subtitle: str, recordings: Sequence[tuple[str, Recording]]) -> Figure:
    """Trajectories of several policies side by side."""
    columns = min(3, len(recordings))
    rows = -(-len(recordings) // columns)
    figure = make_figure(title, subtitle, (max(4.5 * columns, TITLED_IN), 0.8 + 4.5 * rows))
    before: list[str] = []
    for ax, (name, recording) in zip(panels(figure, len(recordings), columns), recordings, strict=True):
        draw_trajectories(ax, recording.scene, recording.task, recording.tracks, "")
        labels = [track.label for track in recording.tracks]
        space = "\n" + ax.get_title() if len(labels) > 1 else ""  # height of the key above the axes
        if (legend := ax.get_legend()) and labels == before:
            legend.remove()  # same colors as in the panel before
        ax.set_title("")
        panel_title(ax, name + space, linespacing=1.5)
        before = labels
    return figure


def starts_figure(runs: Sequence[tuple[str, str, ArchivedRun]]) -> Figure:
    """Poses of the scenarios side by side (Figs. 3.13-3.15).

    Args:
        runs: name, figure of the thesis and one run of each scenario.
    """
    figure = make_figure(
        "Start and goal poses of the scenarios",
        "blue: initial poses, violet: further evaluation poses, red: goals",
        (13.6, 5.6),
    )  # fmt: skip
    for ax, (name, number, archived) in zip(panels(figure, len(runs), len(runs)), runs, strict=True):
        run = archived.run
        points = plan_view.task_points(run.task, run.tests)
        view = plan_view.close_view(run.scene, points, aspect=(1.0, 1.0))
        plan_view.draw_harbor(ax, run.scene, view)
        plan_view.draw_poses(ax, run.scene, run.task, run.tests)
        panel_title(ax, name)
        _cite(ax, number)
    return figure


def surge_figure(vessel: Vessel) -> Figure:
    """Surge of a boat that starts at rest with full force (Fig. 3.10), in closed form.

    With the rudder amidships, (m - X_udot) u' = P - X_u u - X_uu u² is a Riccati equation.
    """
    force, mass = vessel.max_propeller_n, vessel.mass_kg - vessel.X_udot_kg
    linear, square = vessel.X_u_kgps, vessel.X_uu_kgpm
    root = np.sqrt(linear**2 + 4 * square * force)
    top = (root - linear) / (2 * square)
    time = np.linspace(0, 30, 301)  # [s]
    decay = np.exp(-root * time / mass)
    speed = top * (1 - decay) / (1 + decay * (root - linear) / (root + linear))
    figure, ax = make_axes(
        "Surge at full force", f"{force:g} N and rudder amidships, from rest; limit {top:.4f} m/s"
    )
    ax.plot(time, speed, color=palette.SINGLE)
    ax.axhline(top, color=palette.INK_SOFT, lw=1.0, ls=(0, (4, 2)))
    ax.set_xlabel("Time [s]")
    ax.set_ylabel("Surge u [m/s]")
    ax.set_ylim(0, 1.1 * top)
    _cite(ax, "3.10")
    return figure


def _draw_controls(figure: SubFigure, tracks: Sequence[Track], task: Task, cited: Sequence[str]) -> None:
    axes = figure.subplots(len(tracks), 2, sharex=True, sharey="col", squeeze=False)
    end = max(float(track.table["time_s"].iloc[-1]) for track in tracks)
    for row, track in zip(axes, tracks, strict=True):
        for ax, (draw, label) in zip(row, CONTROLS, strict=True):
            draw(ax, [track], task)
            ax.set_xlim(0, 1.015 * end)
            ax.set_ylabel(label, fontsize=8.5)
            ax.set_xlabel("Time [s]" if track is tracks[-1] else "")
        panel_title(row[0], track.label, fontsize=8.5, color=track.color, pad=2)
    for ax, number in zip(axes[0], cited, strict=True):
        _cite(ax, number)


def _cite(ax: Axes, number: str) -> None:
    if number:
        ax.set_title(f"Fig. {number}", loc="right", fontsize=8.5, color=palette.INK_SOFT)
