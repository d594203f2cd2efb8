"""Training curves: return, duration, epsilon, phase, outcomes, updates (thesis Figs. 4.1-4.3, 4.21-4.23)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import cycle

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.ticker import MaxNLocator

from dockctl.analysis.episodes import (
    by_start,
    from_initial_poses,
    moving_average,
    smoothing_window,
    term_columns,
)
from dockctl.drawing import palette
from dockctl.reports.style import legend_above, log_scale, panel_title, percent, thousands

TERM_COLORS = {
    "collision": palette.COLLISION,
    "final": palette.DOCKED,
    "intermediate": "#8CCBB6",
    "distance": palette.BLUE,
    "orientation": palette.PURPLE,
    "speed": palette.TIMEOUT,
    "progress": "#3AA6B9",
}
OTHER_TERMS = ("#8A6E5A", "#7B8794", "#D98BB4", "#5D6BB0")
"""Colors of reward terms that are not built in."""
UPDATE_COLUMNS = {
    "loss": "Loss",
    "td_error": "Mean |TD error|",
    "q_mean": "Mean Q",
    "gradient_norm": "Gradient norm",
}
"""Columns of ``updates.csv`` that are drawn; all but the mean Q on a logarithmic axis."""


def draw_reward(ax: Axes, episodes: pd.DataFrame) -> None:
    """Draw the return of each episode and its moving average (Fig. 4.1)."""
    _draw_episodes(ax, episodes, "return")
    ax.set_ylabel("Return of the episode")
    thousands(ax, "y")


def draw_duration(ax: Axes, episodes: pd.DataFrame) -> None:
    """Draw the number of control steps of each episode and its moving average (Fig. 4.2)."""
    _draw_episodes(ax, episodes, "steps")
    ax.set(ylabel="Duration [control steps]", ylim=(0, None))


def draw_epsilon(ax: Axes, episodes: pd.DataFrame) -> None:
    """Draw the probability of a random action at the end of each episode (Fig. 4.3)."""
    ax.plot(episodes["episode"], episodes["epsilon"], color=palette.MEAN)
    ax.fill_between(episodes["episode"], episodes["epsilon"], color=palette.RAW, alpha=0.35, lw=0)
    last = episodes.iloc[-1]
    ax.annotate(
        f"{last['epsilon']:.2g}", (last["episode"], last["epsilon"]), xytext=(-2, 6),
        textcoords="offset points", ha="right", color=palette.MEAN,
    )  # fmt: skip
    ax.set(ylabel="ε, probability of a random action", ylim=(0, 1.03))
    _label_episodes(ax, episodes)


def draw_phase(ax: Axes, episodes: pd.DataFrame) -> None:
    """Draw which episodes from an initial pose reached the intermediate pose, and their share (Fig. 4.23)."""
    selected = from_initial_poses(episodes)
    window = smoothing_window(selected)
    jitter = np.random.default_rng(0).uniform(-0.035, 0.035, len(selected))  # separates the dots
    ax.plot(
        selected["episode"], selected["phase"] + jitter, ".", ms=2.6, color=palette.RAW, rasterized=True,
        label="episodes",
    )  # fmt: skip
    share = moving_average(selected["phase"], window)
    ax.plot(selected["episode"], share, color=palette.MEAN, label=f"mean of {window} episodes")
    ax.set_yticks([0, 0.25, 0.5, 0.75, 1], ["no", "25 %", "50 %", "75 %", "yes"])
    ax.set(ylim=(-0.08, 1.08), ylabel="Intermediate pose reached")
    legend_above(ax, [("episode", palette.RAW), (f"share of {window} episodes", palette.MEAN)])
    _label_episodes(ax, episodes)


def draw_outcomes(ax: Axes, episodes: pd.DataFrame) -> None:
    """Draw the shares of docked, timeout and collision among the last episodes."""
    window = smoothing_window(episodes)
    outcomes = [(episodes["outcome"] == name).astype(float) for name in palette.OUTCOMES]
    shares = [moving_average(outcome, window) for outcome in outcomes]
    colors = [to_rgba(color, 0.85) for color in palette.OUTCOMES.values()]
    ax.stackplot(episodes["episode"], *shares, colors=colors, edgecolor="white", lw=0.6)
    ax.set_ylim(0, 1)
    percent(ax.yaxis)
    ax.set_ylabel(f"Share of the last {window} episodes")
    ax.grid(False)
    legend_above(ax, list(palette.OUTCOMES.items()))
    _label_episodes(ax, episodes)


def draw_terms(ax: Axes, episodes: pd.DataFrame) -> None:
    """Draw the moving average of each reward term per episode; gains stack upward, costs downward."""
    colors = term_colors(episodes)
    window = smoothing_window(episodes)
    top, bottom = np.zeros(len(episodes)), np.zeros(len(episodes))
    for name, color in colors:
        mean = moving_average(episodes[f"reward_{name}"], window).to_numpy()
        for base, part in ((top, mean.clip(min=0)), (bottom, mean.clip(max=0))):
            if part.any():
                ax.fill_between(episodes["episode"], base, base + part, color=color, alpha=0.85, lw=0)
                base += part
    ax.plot(episodes["episode"], moving_average(episodes["return"], window), color=palette.INK, lw=1.6)
    ax.axhline(0, color=palette.INK_SOFT, lw=0.8)
    ax.set_ylabel(f"Reward per episode, mean of {window}")
    thousands(ax, "y")
    legend_above(ax, [*colors, ("total", palette.INK)], columns=7)
    _label_episodes(ax, episodes)


def term_colors(table: pd.DataFrame) -> list[tuple[str, str]]:
    """Return name and color of each reward term of a table, in the order of its columns."""
    others = cycle(OTHER_TERMS)
    names = [column.removeprefix("reward_") for column in term_columns(table)]
    return [(name, TERM_COLORS.get(name) or next(others)) for name in names]


def draw_evaluations(ax: Axes, evaluations: pd.DataFrame, names: Sequence[str]) -> None:
    """Draw the outcome from each evaluation pose, one column per evaluation; stars mark the best policy.

    The last row shows the shares of the outcomes from the validation starts.
    """
    steps = sorted(evaluations["env_steps"].unique())
    poses = evaluations["start_kind"] != "validation"
    lines = sorted(evaluations["pose"][poses].unique())
    labels = [names[pose] if pose < len(names) else f"pose {pose}" for pose in lines]
    table = evaluations.assign(line=np.where(poses, np.searchsorted(lines, evaluations["pose"]), len(lines)))
    if not poses.all():
        labels.append("validation starts")
    cells = table.groupby(["env_steps", "line"])["outcome"].value_counts(normalize=True)
    shares = cells.unstack(fill_value=0)
    left = np.searchsorted(steps, shares.index.get_level_values("env_steps")) - 0.45
    for outcome in (name for name in palette.OUTCOMES if name in shares):
        width = 0.9 * shares[outcome].to_numpy()
        drawn = width > 0
        line = shares.index.get_level_values("line")[drawn]
        ax.barh(line, width[drawn], left=left[drawn], height=0.86, color=palette.OUTCOMES[outcome], lw=0)
        left = left + width
    stars = np.searchsorted(steps, sorted(evaluations[evaluations["best"] == 1]["env_steps"].unique()))
    ax.plot(stars, np.full(len(stars), len(labels) - 0.22), "*", color=palette.INK, ms=6, clip_on=False)
    ax.set_yticks(range(len(labels)), labels)
    ax.set_ylim(len(labels) + 0.1, -0.5)
    shown = range(0, len(steps), max(1, -(-len(steps) // 8)))
    ax.set_xticks(list(shown), [f"{steps[i]:,}" for i in shown])
    ax.set_xlim(-0.6, len(steps) - 0.4)
    ax.set_xlabel("Environment steps at the evaluation   (★ best policy so far)")
    ax.grid(False)
    legend_above(ax, list(palette.OUTCOMES.items()))


def update_columns(updates: pd.DataFrame) -> list[str]:
    """Return those of `UPDATE_COLUMNS` that the algorithm recorded."""
    return [name for name in UPDATE_COLUMNS if name in updates and updates[name].notna().any()]


def draw_updates(axes: Iterable[Axes], updates: pd.DataFrame, columns: Sequence[str]) -> None:
    """Draw diagnostics of the updates over the environment steps, with their moving average.

    Args:
        axes: one for each column.
        updates: ``updates.csv``.
        columns: keys of `UPDATE_COLUMNS`.
    """
    window = smoothing_window(updates)
    for ax, column in zip(axes, columns, strict=True):
        ax.plot(updates["env_steps"], updates[column], color=palette.RAW, lw=0.8, label=column)
        mean = moving_average(updates[column], window)
        ax.plot(updates["env_steps"], mean, color=palette.MEAN, lw=1.5, label=f"{column}, mean of {window}")
        if column != "q_mean" and (updates[column].dropna() > 0).all():
            log_scale(ax)
        ax.set_xlim(0, max(updates["env_steps"].max(), 1))
        panel_title(ax, UPDATE_COLUMNS[column])
        ax.xaxis.set_major_locator(MaxNLocator(5))
        thousands(ax)


def _draw_episodes(ax: Axes, episodes: pd.DataFrame, column: str) -> None:
    """Draw dots and their moving average, separately for initial poses and other starts."""
    initial, others, kinds = by_start(episodes)
    groups = [
        ("from an initial pose", initial, palette.RAW, palette.MEAN),
        (f"{kinds} start", others, palette.SECOND_RAW, palette.SECOND_MEAN),
    ]
    groups = [group for group in groups if len(group[1])]
    for name, table, light, _ in groups:
        ax.plot(
            table["episode"], table[column], ".", ms=2.6, color=light, rasterized=True,
            label=f"{name}, episodes",
        )  # fmt: skip
    window = smoothing_window(groups[0][1])
    for name, table, _, dark in groups:
        mean = moving_average(table[column], window)
        ax.plot(table["episode"], mean, color=dark, label=f"{name}, mean of {window}")
    if len(groups) > 1:
        legend_above(ax, [(f"{name}, mean of {window}", dark) for name, _, _, dark in groups])
    else:
        legend_above(ax, [("episode", groups[0][2]), (f"mean of {window}", groups[0][3])])
    _label_episodes(ax, episodes)


def _label_episodes(ax: Axes, episodes: pd.DataFrame) -> None:
    first, last = episodes["episode"].min(), episodes["episode"].max()
    ax.set(xlim=(first, max(last, first + 1)), xlabel="Episode")
    thousands(ax)
