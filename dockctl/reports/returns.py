"""Discounted returns of behaviors, by reward term, for several distance units (``dockctl returns``)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dockctl.analysis.returns import DOCKING, INTERMEDIATE, break_even, format_unit, value
from dockctl.drawing import palette
from dockctl.reports.learning import term_colors
from dockctl.reports.style import label, legend_above, make_figure, thousands

UNIT_COLORS = (palette.MEAN, palette.SECOND_MEAN, palette.PURPLE, palette.GREEN)
ENDINGS = {"docked": "docks", "collision": "collides", "timeout": "timeout"}


def returns_figure(table: pd.DataFrame, caption: str) -> Figure:
    """Draw bars for each distance unit, and the advantage of docking if there is an intermediate pose.

    Args:
        table: columns `dockctl.runs.tables.RETURNS` and one ``reward_<term>`` per term.
        caption: scenario and policy.
    """
    units = [float(unit) for unit in table["distance_unit_m"].unique()]
    by_unit = [table[table["distance_unit_m"] == unit] for unit in units]
    has_intermediate = break_even(by_unit[0]) is not None
    widths = [1.0] * len(units) + [0.8] * has_intermediate
    figure = make_figure(
        "Discounted returns of behaviors, by reward term",
        caption,
        (2.2 + 4.3 * sum(widths), 1.9 + 0.46 * len(by_unit[0])),
    )
    axes = np.atleast_1d(figure.subplots(1, len(widths), width_ratios=widths))
    for i, (unit, rows) in enumerate(zip(units, by_unit, strict=True)):
        draw_returns(axes[i], rows)
        axes[i].set_xlabel(f"Discounted return, δd in {format_unit(unit)}")
        axes[i].tick_params(labelleft=i == 0)
    legend_above(axes[0], term_colors(table), columns=6)
    if has_intermediate:
        colors = [UNIT_COLORS[i % len(UNIT_COLORS)] for i in range(len(units))]
        for rows, color in zip(by_unit, colors, strict=True):
            draw_advantage(axes[-1], rows, color)
        names = [f"δd in {format_unit(unit)}" for unit in units]
        legend_above(axes[-1], list(zip(names, colors, strict=True)), columns=2)
    return figure


def draw_returns(ax: Axes, rows: pd.DataFrame) -> None:
    """Draw one bar per behavior: gains to the right, costs to the left, and a marker at the return."""
    rows = rows.reset_index(drop=True)
    gain, cost = np.zeros(len(rows)), np.zeros(len(rows))
    for name, color in term_colors(rows):
        values = rows[f"reward_{name}"].to_numpy(float)
        for base, part in ((gain, values.clip(min=0)), (cost, values.clip(max=0))):
            ax.barh(rows.index, part, left=base, height=0.62, color=color, alpha=0.88, lw=0)
            base += part
    ax.plot(rows["return"], rows.index, "D", ms=5, color=palette.INK, mec="white", mew=0.9, zorder=4)
    for i, (_, row) in enumerate(rows.iterrows()):
        text = f"{row['return']:,.0f}".replace("-", "−")
        weight = "bold" if row["outcome"] == "docked" else "normal"
        label(ax, text, (gain[i], i), (5, 0), va="center", fontsize=8.5, fontweight=weight, zorder=5)
    ax.axvline(0, color=palette.INK_SOFT, lw=0.8, zorder=3)
    low, high = cost.min(), gain.max()
    ax.set_xlim(low - 0.03 * (high - low), high + 0.24 * (high - low))
    labels = [
        f"{row['behavior']}\n{ENDINGS[row['outcome']]} after {row['time_s']:g} s"
        for _, row in rows.iterrows()
    ]
    ax.set_yticks(rows.index, labels)
    ax.set_ylim(len(rows) - 0.45, -0.55)
    ax.grid(axis="y", visible=False)
    ax.locator_params(axis="x", nbins=6)
    thousands(ax)


def draw_advantage(ax: Axes, rows: pd.DataFrame, color: str) -> None:
    """Draw the advantage of docking over loitering before the intermediate pose, over that pose's reward."""
    even, discount = break_even(rows), value(rows, DOCKING, "intermediate_discount")
    assert even is not None  # drawn only with an intermediate pose
    paid = value(rows, DOCKING, INTERMEDIATE) / discount
    reward = np.array([0.0, max(3.5 * paid, 1.6 * even)])
    ax.plot(reward, discount * (reward - even), color=color)
    ax.plot(paid, discount * (paid - even), "o", color=color, mec="white", ms=7, zorder=4)
    if even > 0:
        ax.plot(even, 0, "D", color=color, mec="white", ms=6, zorder=4)
        label(ax, f"break-even {even:,.0f}", (even, 0), (6, -14), fontsize=8.5, color=color)
    ax.axhline(0, color=palette.INK_SOFT, lw=0.8, zorder=1)
    ax.set_xlim(*ax.dataLim.intervalx)
    ax.locator_params(nbins=5)
    ax.set_xlabel("Reward of the intermediate pose   (● in the scenario)")
    ax.set_ylabel("Docking minus loitering before the intermediate pose")
    thousands(ax, "y")
    thousands(ax)
