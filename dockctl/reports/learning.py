"""How a run learned: reward, duration, epsilon, phase, outcomes (thesis Figs. 4.1-4.3, 4.21-4.23)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.ticker import PercentFormatter

from dockctl.analysis.learning import from_initial_poses, moving_average, smoothing_window, term_columns
from dockctl.drawing import palette
from dockctl.reports.style import legend_above, thousands

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


def draw_reward(ax: Axes, episodes: pd.DataFrame) -> None:
    """Return of every episode, and its mean (Fig. 4.1)."""
    _dots_and_means(ax, episodes, "return")
    ax.set_ylabel("Total reward of the episode")
    thousands(ax, "y")


def draw_duration(ax: Axes, episodes: pd.DataFrame) -> None:
    """Control steps of every episode, and their mean (Fig. 4.2)."""
    _dots_and_means(ax, episodes, "steps")
    ax.set_ylabel("Duration [control steps]")
    ax.set_ylim(bottom=0)


def draw_epsilon(ax: Axes, episodes: pd.DataFrame) -> None:
    """Probability of a random action at the end of every episode (Fig. 4.3)."""
    ax.plot(episodes["episode"], episodes["epsilon"], color=palette.MEAN)
    ax.fill_between(episodes["episode"], episodes["epsilon"], color=palette.RAW, alpha=0.35, lw=0)
    last = episodes.iloc[-1]
    ax.annotate(
        f"{last['epsilon']:.2g}",
        (last["episode"], last["epsilon"]),
        xytext=(-2, 6),
        textcoords="offset points",
        ha="right",
        color=palette.MEAN,
    )
    ax.set_ylabel("ε, share of random actions")
    ax.set_ylim(0, 1.03)
    _episode_axis(ax, episodes)


def draw_phase(ax: Axes, episodes: pd.DataFrame) -> None:
    """Phase at the end of the episodes that began at an initial pose, and the share in phase 1 (4.23)."""
    ours = from_initial_poses(episodes)
    window = smoothing_window(ours)
    rng = np.random.default_rng(0)  # spreads the dots, which would otherwise hide each other
    ax.plot(
        ours["episode"],
        ours["phase"] + rng.uniform(-0.035, 0.035, len(ours)),
        ".",
        ms=2.6,
        color=palette.RAW,
        rasterized=True,
        label="episodes",
    )
    ax.plot(
        ours["episode"],
        moving_average(ours["phase"], window),
        color=palette.MEAN,
        label=f"mean of {window} episodes",
    )
    ax.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0  aligning", "25 %", "50 %", "75 %", "1  docking"])
    ax.set_ylim(-0.08, 1.08)
    ax.set_ylabel("Task at the end of the episode")
    legend_above(
        ax, [("episode", palette.RAW), (f"share past the intermediate pose, of {window}", palette.MEAN)]
    )
    _episode_axis(ax, episodes)


def draw_outcomes(ax: Axes, episodes: pd.DataFrame) -> None:
    """How the last episodes ended: docked, ran out of time, or hit something."""
    window = smoothing_window(episodes)
    shares = [
        moving_average((episodes["outcome"] == outcome).astype(float), window) for outcome in palette.OUTCOMES
    ]
    colors = [to_rgba(color, 0.85) for color in palette.OUTCOMES.values()]
    ax.stackplot(episodes["episode"], *shares, colors=colors, edgecolor="white", lw=0.6)
    ax.set_ylim(0, 1)
    ax.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    ax.set_ylabel(f"Share of the last {window} episodes")
    ax.grid(False)
    legend_above(ax, list(palette.OUTCOMES.items()))
    _episode_axis(ax, episodes)


def draw_terms(ax: Axes, episodes: pd.DataFrame) -> None:
    """What every reward term paid or cost an episode, as a mean; gains stack up, costs stack down."""
    columns = term_columns(episodes)
    window = smoothing_window(episodes)
    others = iter(OTHER_TERMS * (1 + len(columns) // len(OTHER_TERMS)))
    top, bottom = np.zeros(len(episodes)), np.zeros(len(episodes))
    entries = []
    for column in columns:
        name = column.removeprefix("reward_")
        color = TERM_COLORS.get(name) or next(others)
        mean = moving_average(episodes[column], window).to_numpy()
        for base, part in ((top, mean.clip(min=0)), (bottom, mean.clip(max=0))):
            if part.any():
                ax.fill_between(episodes["episode"], base, base + part, color=color, alpha=0.85, lw=0)
                base += part
        entries.append((name, color))
    ax.plot(episodes["episode"], moving_average(episodes["return"], window), color=palette.INK, lw=1.6)
    ax.axhline(0, color=palette.INK_SOFT, lw=0.8)
    ax.set_ylabel(f"Reward an episode, mean of {window}")
    thousands(ax, "y")
    legend_above(ax, [*entries, ("total", palette.INK)], columns=7)
    _episode_axis(ax, episodes)


def draw_evaluations(ax: Axes, evaluations: pd.DataFrame, names: Sequence[str]) -> None:
    """How the greedy policy ended from each test pose, a column an evaluation; stars mark the best so far."""
    steps = sorted(evaluations["env_steps"].unique())
    poses = sorted(evaluations["pose"].unique())
    for outcome, color in palette.OUTCOMES.items():
        rows = evaluations[evaluations["outcome"] == outcome]
        columns = np.searchsorted(steps, rows["env_steps"])
        ax.barh(
            np.searchsorted(poses, rows["pose"]), 0.9, left=columns - 0.45, height=0.86, color=color, lw=0
        )
    stars = np.searchsorted(steps, sorted(evaluations[evaluations["best"] == 1]["env_steps"].unique()))
    ax.plot(stars, np.full(len(stars), len(poses) - 0.22), "*", color=palette.INK, ms=6, clip_on=False)
    labels = [names[pose] if pose < len(names) else f"pose {pose}" for pose in poses]
    ax.set_yticks(range(len(poses)), labels)
    ax.set_ylim(len(poses) + 0.1, -0.5)
    shown = range(0, len(steps), max(1, -(-len(steps) // 8)))
    ax.set_xticks(list(shown), [f"{steps[i]:,}" for i in shown])
    ax.set_xlim(-0.6, len(steps) - 0.4)
    ax.set_xlabel("Environment steps at the evaluation   (★ best policy so far)")
    ax.grid(False)
    legend_above(ax, list(palette.OUTCOMES.items()))


def _dots_and_means(ax: Axes, episodes: pd.DataFrame, column: str) -> None:
    """Every episode as a light dot and the running mean as a dark line, apart for the two kinds of start."""
    exploring = episodes["start_kind"] == "exploring"
    groups = [
        ("from an initial pose", episodes[~exploring], palette.RAW, palette.MEAN),
        ("exploring start", episodes[exploring], palette.SECOND_RAW, palette.SECOND_MEAN),
    ]
    groups = [group for group in groups if len(group[1])]
    for name, table, light, _ in groups:
        ax.plot(
            table["episode"],
            table[column],
            ".",
            ms=2.6,
            color=light,
            rasterized=True,
            label=f"{name}, episodes",
        )
    window = smoothing_window(groups[0][1])
    for name, table, _, dark in groups:
        ax.plot(
            table["episode"],
            moving_average(table[column], window),
            color=dark,
            label=f"{name}, mean of {window}",
        )
    if len(groups) > 1:
        legend_above(ax, [(f"{name}, mean of {window}", dark) for name, _, _, dark in groups])
    else:
        legend_above(ax, [("episode", groups[0][2]), (f"mean of {window}", groups[0][3])])
    _episode_axis(ax, episodes)


def _episode_axis(ax: Axes, episodes: pd.DataFrame) -> None:
    first, last = episodes["episode"].min(), episodes["episode"].max()
    ax.set_xlim(first, max(last, first + 1))
    ax.set_xlabel("Episode")
    thousands(ax)
