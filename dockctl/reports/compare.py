"""Comparison of policies on the same episodes: outcomes and paired differences (``dockctl compare``)."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dockctl.analysis.contrast import MEASURES, SUCCESS, Contrast, Measure, contrasts
from dockctl.analysis.statistics import wilson_interval
from dockctl.console import count
from dockctl.drawing import palette
from dockctl.reports.style import label, make_figure, panel_title, percent

ROW_IN, LINE_IN = 0.46, 0.17
"""Height per policy, and per additional line of the longest name [inches]."""
NAME_CHARACTERS, TITLE_CHARACTERS = 36, 14
"""Length of a line in the name of a policy, which `--vary` makes long, and in the title of a measure."""
UNCLEAR_COLOR = "#8296A5"
"""Color of a difference whose interval contains zero."""


def compare_figure(table: pd.DataFrame, kinds: Mapping[str, str], caption: str) -> Figure:
    """Draw the outcomes of each policy, and its differences from the first with 95 % intervals.

    Args:
        table: columns ``policy`` and `dockctl.runs.tables.EVALUATION`, the same starts for every policy.
        kinds: names of the kinds of starts.
        caption: the scenario.
    """
    policies = list(table["policy"].unique())
    present = list(table["start_kind"].unique())
    shown = [kind for kind in present if kind != "pose"] or present
    found = list(contrasts(table))
    lines = max(len(_name(policy).splitlines()) for policy in policies)
    rows = len(shown) * (len(policies) * (ROW_IN + (lines - 1) * LINE_IN) + 0.95)
    figure = make_figure(
        "The same episodes compared", f"{caption}; Δ to {policies[0]}, paired", (12.4, 1.55 + rows)
    )
    grid = figure.subplots(
        len(shown),
        2 + len(MEASURES),
        squeeze=False,
        sharey=True,
        width_ratios=(2.1, *[1.0] * (1 + len(MEASURES))),
    )
    for axes, kind in zip(grid, shown, strict=True):
        episodes = table[table["start_kind"] == kind]
        title = f"{kinds.get(kind, kind)}, {count(len(episodes) // len(policies), 'episode')}"
        draw_outcomes(axes[0], episodes, policies, title)
        for ax, measure in zip(axes[1:], (SUCCESS, *MEASURES), strict=True):
            draw_differences(ax, measure, [c for c in found if c.kind == kind], len(policies))
    _legend(figure, policies[0])
    return figure


def draw_outcomes(ax: Axes, table: pd.DataFrame, policies: Sequence[str], title: str) -> None:
    """Draw one bar of outcome shares per policy, and the success rate with its Wilson interval."""
    for row, policy in enumerate(policies):
        outcomes = table.loc[table["policy"] == policy, "outcome"]
        left = 0.0
        for outcome, color in palette.OUTCOMES.items():
            share = float((outcomes == outcome).mean())
            ax.barh(row, share, 0.62, left=left, color=color, lw=0)
            left += share
        docked = int((outcomes == "docked").sum())
        low, high = wilson_interval(docked, len(outcomes))
        ax.plot([low, high], [row, row], color=palette.INK, lw=1.6, solid_capstyle="butt")
        ax.plot(docked / len(outcomes), row, "o", ms=4.5, color=palette.INK, clip_on=False, zorder=5)
        ax.annotate(
            f"{SUCCESS.text(docked / len(outcomes))} %",
            (1.0, row),
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.5,
            fontweight="bold",
            annotation_clip=False,
        )
    ax.set_yticks(range(len(policies)), list(map(_name, policies)))
    ax.tick_params(axis="y", labelcolor=palette.INK, labelsize=9)
    ax.set(ylim=(len(policies) - 0.5, -0.5), xlim=(0, 1))
    ax.set_xticks([0, 0.5, 1])
    percent(ax.xaxis)
    ax.grid(False)
    panel_title(ax, title, pad=6)


def draw_differences(ax: Axes, measure: Measure, found: Sequence[Contrast], policies: int) -> None:
    """Draw the difference of each policy from the first in one measure, with its interval."""
    ax.axvline(0, color=palette.INK_SOFT, lw=0.9)
    ends = [0.0]
    for row, contrast in enumerate(found, start=1):
        if (compared := contrast.compared.get(measure)) is not None:
            difference = compared.difference
            value, low, high = (
                measure.factor * x for x in (difference.value, difference.low, difference.high)
            )
            color = palette.INK if difference.is_clear else UNCLEAR_COLOR
            ax.plot([low, high], [row, row], color=color, lw=1.8, solid_capstyle="butt")
            ax.plot(value, row, "o", ms=5.5, color=color, zorder=3)
            text = measure.text(difference.value, signed=True)
            label(ax, text, (value, row), (0, 6), ha="center", va="bottom", color=color)
            ends += [low, high]
    margin = max(0.16 * np.ptp(ends), 5 * 10.0**-measure.decimals)
    ax.set_xlim(min(ends) - margin, max(ends) + margin)
    ax.xaxis.set_major_locator(MaxNLocator(2))
    panel_title(ax, textwrap.fill(f"Δ {measure.name}", TITLE_CHARACTERS), pad=6)
    ax.set_xlabel(f"[{measure.unit}]", fontsize=8.5, labelpad=2)
    ax.spines["left"].set_visible(False)
    ax.tick_params(axis="y", labelleft=False)
    ax.set_ylim(policies - 0.5, -0.5)
    if found and (compared := found[0].compared.get(measure)) is not None:
        left, right = ax.get_xlim()
        shift, side = (-4, "right") if right < -left else (4, "left")
        text = measure.quantity(compared.first)
        label(ax, text, (0, 0), (shift, 0), ha=side, va="center", color=palette.INK_SOFT)


def _name(policy: str) -> str:
    """Return the name of a policy, wrapped into lines."""
    return textwrap.fill(policy, NAME_CHARACTERS, break_on_hyphens=False)


def _legend(figure: Figure, first: str) -> None:
    entries: list[Patch | Line2D] = [
        Patch(color=color, label=name) for name, color in palette.OUTCOMES.items()
    ]
    entries.append(Line2D([], [], color=palette.INK, marker="o", ms=5, label="with 95 % interval"))
    entries.append(Line2D([], [], color=UNCLEAR_COLOR, marker="o", ms=5, label=f"Δ to {first} may be zero"))
    figure.legend(
        handles=entries, loc="outside lower left", ncols=len(entries), handlelength=1.4, borderaxespad=0.9
    )
