"""Figures of a run, by file name (``dockctl plot``)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dockctl.analysis.episodes import term_columns
from dockctl.console import count
from dockctl.drawing.scene import Scene
from dockctl.reports import learning, plan_view, trajectory
from dockctl.reports.plan_view import Track, split_tracks
from dockctl.reports.style import make_axes, make_figure, panel_title, panels
from dockctl.runs.reader import Run
from dockctl.runs.tables import RECENT
from dockctl.scenarios.schema import Task

DrawEpisodes = Callable[[Axes, pd.DataFrame], None]
DrawTracks = Callable[[Axes, Sequence[Track], Task], None]

TRAINING: dict[str, tuple[str, DrawEpisodes]] = {
    "training-reward": ("Return of the training episodes", learning.draw_reward),
    "training-duration": ("Duration of the training episodes", learning.draw_duration),
    "training-epsilon": ("Exploration during training", learning.draw_epsilon),
    "training-phase": ("Training episodes that reach the intermediate pose", learning.draw_phase),
    "training-outcomes": ("Outcomes of the training episodes", learning.draw_outcomes),
    "training-reward-terms": ("Reward by term", learning.draw_terms),
}
DOCKING: dict[str, tuple[str, DrawTracks]] = {
    "docking-distance": ("Distance to the goal", trajectory.draw_distance),
    "docking-heading-error": ("Heading error to the goal", trajectory.draw_heading_error),
    "docking-velocity": ("Surge and sway", trajectory.draw_velocity),
    "docking-yaw-rate": ("Yaw rate", trajectory.draw_yaw_rate),
}
COMMANDS: dict[str, tuple[str, DrawTracks]] = {
    "docking-propeller": ("Propeller force", trajectory.draw_propeller),
    "docking-rudder": ("Rudder angle", trajectory.draw_rudder),
}


def figures(run: Run) -> Iterator[tuple[str, Figure]]:
    """Yield name and figure for everything that the tables of a run contain."""
    if run.episodes is not None:
        yield from training_figures(run, run.episodes)
    if run.updates is not None and (columns := learning.update_columns(run.updates)):
        yield "training-updates", updates_figure(run, run.updates, columns)
    if run.evaluations is not None:
        yield "training-evaluations", evaluation_figure(run, run.evaluations)
    if run.trajectories is not None:
        tracks = split_tracks(run.trajectories)
        yield "docking-poses", pose_figure(run, tracks)
        yield from docking_figures(run, tracks)
        if run.episodes is not None:
            yield "overview", overview(run, run.episodes, tracks)


def training_figures(run: Run, episodes: pd.DataFrame) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of the training episodes: Figs. 4.1-4.3 and 4.23, outcomes and reward terms."""
    for name, (title, draw) in TRAINING.items():
        is_empty: dict[DrawEpisodes, bool] = {
            learning.draw_phase: run.task.intermediate is None,
            learning.draw_terms: not term_columns(episodes),
            learning.draw_epsilon: bool(episodes["epsilon"].isna().all()),  # not every algorithm has one
        }
        if is_empty.get(draw):
            continue
        figure, ax = make_axes(title, f"{run.caption}, {count(len(episodes), 'episode')}")
        draw(ax, episodes)
        yield name, figure


def updates_figure(run: Run, updates: pd.DataFrame, columns: Sequence[str]) -> Figure:
    """Draw loss, TD error, Q and gradient norm of the updates, one panel each."""
    figure = make_figure("Network updates", run.caption, (10.0, 0.9 + 2.4 * -(-len(columns) // 2)))
    learning.draw_updates(panels(figure, len(columns), 2, sharex=True), updates, columns)
    figure.supxlabel("Environment steps", fontsize=9.5)
    return figure


def evaluation_figure(run: Run, evaluations: pd.DataFrame) -> Figure:
    """Draw the outcomes of the greedy policy from each evaluation pose, and from the validation starts."""
    rows = evaluations["pose"][evaluations["start_kind"] != "validation"].nunique() + 1
    figure, ax = make_axes("Greedy evaluations during training", run.caption, (7.6, 2.3 + 0.3 * rows))
    at_berths = run.task.berths is not None  # then evaluated from random starts
    names = [] if at_berths else [plan_view.pose_names([pose]) for pose in run.tests]
    learning.draw_evaluations(ax, evaluations, names)
    return figure


def pose_figure(run: Run, tracks: Sequence[Track]) -> Figure:
    """Draw the trajectories of the best or recorded policy over the harbor (Fig. 4.4)."""
    plan, view = _plan_and_view(run, tracks)
    height = 6.9 * (view[3] - view[1]) / (view[2] - view[0]) + (1.45 if len(tracks) > 1 else 1.2)
    interval = plan_view.outline_interval(tracks)
    figure, ax = make_axes(
        f"Trajectories of {run.policy}", f"{run.caption}, one outline every {interval:g} s", (7.8, height)
    )
    plan_view.draw_harbor(ax, plan, view)
    plan_view.draw_paths(ax, plan, tracks, run.task)
    plan_view.draw_compass(ax, view)
    return figure


def docking_figures(run: Run, tracks: Sequence[Track]) -> Iterator[tuple[str, Figure]]:
    """Yield distance, heading error, velocities and commands over time (Figs. 4.5-4.10)."""
    for name, (title, draw) in DOCKING.items():
        figure, ax = make_axes(f"{title} while docking", run.caption)
        draw(ax, tracks, run.task)
        trajectory.mark_phases(ax, tracks)
        yield name, figure
    for name, (title, draw) in COMMANDS.items():
        yield name, _command_figure(run, tracks, title, draw)


def _command_figure(run: Run, tracks: Sequence[Track], title: str, draw: DrawTracks) -> Figure:
    """Draw the commands, one row of axes per track."""
    size = (7.6, 4.3) if len(tracks) == 1 else (7.6, 1.2 + 1.25 * len(tracks))
    figure = make_figure(f"{title} while docking", run.caption, size)
    axes = panels(figure, len(tracks), 1, sharex=True, sharey=True)
    axes[0].set_xlim(0, 1.015 * max(track.table["time_s"].iloc[-1] for track in tracks))
    for ax, track in zip(axes, tracks, strict=True):
        draw(ax, [track], run.task)
        trajectory.mark_phases(ax, [track], names=len(tracks) == 1)
        if len(tracks) > 1:
            panel_title(ax, track.label, fontsize=8.5, color=track.color, pad=3)
            label = ax.get_ylabel()
            ax.set_ylabel("")
            ax.label_outer()
    if len(tracks) > 1:
        figure.supylabel(label, fontsize=9.5)
    return figure


def overview(run: Run, episodes: pd.DataFrame, tracks: Sequence[Track]) -> Figure:
    """Draw trajectories over the harbor, training curves, and time series on one page."""
    docked = sum(track.docked for track in tracks)
    last = episodes.tail(RECENT)
    share = float((last["outcome"] == "docked").mean())
    figure = make_figure(
        f"Overview of scenario {run.scenario}",
        f"seed {run.seed}, {count(len(episodes), 'training episode')}, {share:.0%} of the last {len(last)}"
        f" docked; the best policy docks from {docked} of {count(len(tracks), 'evaluation pose')}",
        (12.4, 8.4),
    )
    grid = figure.add_gridspec(2, 2, height_ratios=(2.1, 1.0), width_ratios=(1.15, 1.0))
    left, right, lower = (figure.add_subfigure(cell) for cell in (grid[0, 0], grid[0, 1], grid[1, :]))
    plan, view = _plan_and_view(run, tracks, aspect=(1.3, 1.3))
    paths = left.add_subplot()
    plan_view.draw_harbor(paths, plan, view)
    plan_view.draw_paths(paths, plan, tracks, run.task)
    plan_view.draw_compass(paths, view)
    for ax, draw in zip(right.subplots(2), (learning.draw_reward, learning.draw_outcomes), strict=True):
        draw(ax, episodes)
    series = (
        trajectory.draw_distance,
        trajectory.draw_heading_error,
        trajectory.draw_velocity,
        trajectory.draw_propeller,
    )
    for ax, draw_series in zip(lower.subplots(1, len(series)), series, strict=True):
        draw_series(ax, tracks, run.task)
        trajectory.mark_phases(ax, tracks, names=False)
        if (legend := ax.get_legend()) and (len(tracks) > 1 or draw_series is not trajectory.draw_velocity):
            legend.remove()  # the colors are those of the paths above
    return figure


def _plan_and_view(
    run: Run, tracks: Sequence[Track], aspect: tuple[float, float] = (0.85, 1.75)
) -> tuple[Scene, plan_view.Bounds]:
    """Return the harbor, with water wherever the boat went, and the view around paths and poses."""
    paths = [track.table[["x_m", "y_m"]].to_numpy(float) for track in tracks]
    points = np.concatenate([*paths, plan_view.task_points(run.task)])
    plan = plan_view.extended(run.scene, points)
    return plan, plan_view.close_view(plan, points, aspect=aspect)
