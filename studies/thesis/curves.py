"""Figures of training runs: curves of several seeds with their interquartile mean and its interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dockctl.analysis.episodes import from_initial_poses, moving_average
from dockctl.drawing import palette
from dockctl.reports import learning
from dockctl.reports.style import (
    legend_above,
    log_scale,
    make_figure,
    panel_title,
    panels,
    percent,
    thousands,
)
from dockctl.runs.tables import RECENT
from studies.thesis.data import ArchivedRun
from studies.thesis.text import POINTS, interquartile_mean, interval, on_common_grid

WINDOW = 50
"""Episodes per mean."""
COLUMNS = 2
"""Panels in a row of a figure."""
SEED_COLORS = palette.SERIES

Measure = Callable[[pd.DataFrame], pd.Series]
Panel = tuple[str, str, Measure]

REWARD: Panel = ("Total reward of an episode", "Fig. {0}", lambda rows: rows["return"])
DURATION: Panel = ("Duration [control steps]", "Fig. {1}", lambda rows: rows["steps"])
EPSILON: Panel = ("ε, share of random actions", "Fig. {2}", lambda rows: rows["epsilon"])
PHASE: Panel = ("Past the intermediate pose", "Fig. {2}", lambda rows: rows["phase"])
DOCKED: Panel = ("Docked", "not in the thesis", lambda rows: (rows["outcome"] == "docked").astype(float))
SHARES = (PHASE, DOCKED)


def training_figure(title: str, runs: Sequence[ArchivedRun], cited: Sequence[str]) -> Figure:
    """Reward, duration, ε or phase, and success over training (as Figs. 4.1-4.3 of the thesis).

    Args:
        cited: figures of the thesis for the first three panels.
    """
    has_phase = runs[0].run.task.intermediate is not None
    panels = (REWARD, DURATION, PHASE if has_phase else EPSILON, DOCKED)
    figure = make_figure(
        title,
        f"{_seeds(runs)}; episodes from an initial pose, means of {WINDOW}; dark: interquartile mean of the"
        " seeds with its 95 % bootstrap interval; dot: end of a training, whose last value is used after it",
        (12.4, 7.6),
    )
    axes = figure.subplots(2, 2).ravel()
    for ax, panel in zip(axes, panels, strict=True):
        draw_seeds(ax, runs, panel)
        if all(cited) or panel is DOCKED:
            ax.set_title(panel[1].format(*cited), loc="right", fontsize=8.5, color=palette.INK_SOFT)
    legend_above(
        axes[0],
        [(f"seed {run.seed}", SEED_COLORS[i % len(SEED_COLORS)]) for i, run in enumerate(runs)],
    )
    return figure


def draw_seeds(ax: Axes, runs: Sequence[ArchivedRun], panel: Panel) -> None:
    """One measure of every seed, and the interquartile mean of the seeds."""
    curves = [_curve(run, panel[2]) for run in runs]
    for i, curve in enumerate(curves):
        color = SEED_COLORS[i % len(SEED_COLORS)]
        ax.plot(curve.index, curve, color=color, lw=0.9, alpha=0.75)
        ax.plot(curve.index[-1], curve.iloc[-1], "o", ms=4, color=color, mec="white", mew=0.6, clip_on=False)
    if len(curves) > 1:
        draw_middle(ax, curves, palette.INK)
    _frame(ax, panel, max(curve.index[-1] for curve in curves))


def draw_middle(ax: Axes, curves: Sequence[pd.Series], color: str) -> None:
    """Interquartile mean of curves with its interval as a band."""
    grid, values = on_common_grid(curves)
    low, high = interval(values)
    ax.fill_between(grid, low, high, color=color, alpha=0.13, lw=0)
    ax.plot(grid, interquartile_mean(values), color=color, lw=2.0)


def compared_figure(
    title: str, subtitle: str, groups: Mapping[str, Mapping[str, Sequence[ArchivedRun]]]
) -> Figure:
    """Share of docked episodes of several sets of runs, one panel per group.

    Args:
        groups: runs by title of the panel and name of the set.
    """
    rows = -(-len(groups) // COLUMNS)
    figure = make_figure(title, subtitle, (12.4, 0.8 + 3.1 * rows))
    axes = panels(figure, len(groups), COLUMNS, sharey=True)
    for ax, (name, sets) in zip(axes, groups.items(), strict=True):
        longest = 0.0
        colors = (palette.INK, palette.RED, palette.BLUE)
        for color, runs in zip(colors, sets.values(), strict=False):
            curves = [_curve(run, DOCKED[2], "env_steps") for run in runs]
            for curve in curves:
                ax.plot(curve.index, curve, color=color, lw=0.7, alpha=0.5)
                ax.plot(curve.index[-1], curve.iloc[-1], "o", ms=3.5, color=color, mec="white", mew=0.6)
            draw_middle(ax, curves, color)
            longest = max(longest, *(curve.index[-1] for curve in curves))
        _frame(ax, DOCKED, longest, "Environment steps")
        ax.set_ylabel("")
        legend_above(ax, [(set_name, color) for set_name, color in zip(sets, colors, strict=False)])
        panel_title(ax, name, loc="right")
    figure.supylabel("Docked", fontsize=9.5, color=palette.INK_SOFT)
    return figure


def endings_figure(title: str, runs: Sequence[tuple[str, ArchivedRun]]) -> Figure:
    """Outcomes of the episodes of single runs over training."""
    rows = -(-len(runs) // COLUMNS)
    figure = make_figure(
        title, f"share of the last {RECENT} episodes by outcome; dark: share past the intermediate pose",
        (12.4, 0.8 + 2.6 * rows),
    )  # fmt: skip
    for ax, (name, run) in zip(panels(figure, len(runs), COLUMNS), runs, strict=True):
        learning.draw_outcomes(ax, run.episodes)
        if run.run.task.intermediate is not None:
            ax.plot(
                run.episodes["episode"],
                moving_average(run.episodes["phase"], RECENT),
                color=palette.INK,
                lw=1.3,
            )
        ax.set_ylabel("")
        panel_title(ax, name, loc="right")
    return figure


def losses_figure(title: str, runs: Sequence[tuple[str, ArchivedRun]]) -> Figure:
    """Mean absolute TD error and mean value of single runs over training."""
    figure = make_figure(
        title, "left: mean |TD error| of the updates, right: mean Q; in units of the reward", (12.4, 4.6)
    )
    left, right = figure.subplots(1, 2)
    colors = (*palette.SERIES, palette.INK)
    for (_, run), color in zip(runs, colors, strict=False):
        table = run.updates
        scale = float(run.training["reward_scale"])
        left.plot(table["env_steps"], moving_average(table["td_error"].abs(), 5) / scale, color=color, lw=1.4)
        right.plot(table["env_steps"], moving_average(table["q_mean"], 5) / scale, color=color, lw=1.4)
    log_scale(left)
    for ax, name in ((left, "Mean |TD error|"), (right, "Mean Q")):
        ax.set_xlabel("Environment steps")
        ax.set_ylabel(name)
        ax.xaxis.set_major_locator(MaxNLocator(5))
        thousands(ax)
    thousands(right, "y")
    legend_above(left, [(name, color) for (name, _), color in zip(runs, colors, strict=False)], columns=3)
    return figure


def docked_over(run: ArchivedRun, steps: int) -> float:
    """Share of docked episodes over the first `steps` steps; after its end a run has its last value."""
    curve = _curve(run, DOCKED[2], "env_steps")
    return float(np.interp(np.linspace(0, steps, POINTS), curve.index.to_numpy(float), curve).mean())


def _curve(run: ArchivedRun, measure: Measure, over: str = "episode") -> pd.Series:
    rows = from_initial_poses(run.episodes)
    smoothed = moving_average(measure(rows).astype(float), WINDOW)
    smoothed.index = pd.Index(rows[over].to_numpy(float))
    return smoothed[~smoothed.index.duplicated(keep="last")]


def _frame(ax: Axes, panel: Panel, longest: float, over: str = "Episode") -> None:
    ax.set_xlim(0, 1.01 * longest)
    ax.set_xlabel(over)
    ax.set_ylabel(panel[0])
    thousands(ax)
    if panel in SHARES:
        ax.set_ylim(-0.02, 1.02)
        percent(ax.yaxis)
    elif panel is REWARD:
        thousands(ax, "y")
    else:
        ax.set_ylim(bottom=0)


def _seeds(runs: Sequence[ArchivedRun]) -> str:
    return "one seed" if len(runs) == 1 else f"{len(runs)} seeds"
