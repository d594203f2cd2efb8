"""Histograms of decision times (thesis Fig. 4.38, ``dockctl latency``)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from dockctl.analysis.latency import PARTS, STATISTICS, summarize, timed_parts
from dockctl.drawing import palette
from dockctl.reports.style import label, make_figure, panel_title

COLORS = {
    "scan_ms": palette.BLUE,
    "state_ms": palette.PURPLE,
    "forward_ms": palette.DOCKED,
    "control_ms": palette.YELLOW,
    "decision_ms": palette.INK,
}


def latency_figure(samples: pd.DataFrame, subtitle: str, control_period_ms: float) -> Figure:
    """Draw one histogram per part of a decision, with the control period marked.

    Args:
        samples: one row per decision, columns `dockctl.analysis.latency.PARTS` [ms].
        subtitle: policy and scenario.
        control_period_ms: time available for a decision.
    """
    parts = timed_parts(samples)
    figure = make_figure("Decision time", subtitle, (7.8, 1.2 + 1.1 * len(parts)))
    axes = figure.subplots(len(parts), sharex=True)
    shortest, longest = float(samples.to_numpy().min()), float(samples.to_numpy().max())
    edges = np.geomspace(max(shortest, 1e-4) / 1.5, 2.5 * max(longest, control_period_ms), 140)
    summary = summarize(samples)
    for ax, part in zip(axes, parts, strict=True):
        _draw_part(ax, samples[part], edges, PARTS[part], COLORS[part], summary[part])
        ax.axvline(control_period_ms, color=palette.GOAL, lw=1.3, ls=(0, (4, 2)))
    label_line(axes[0], control_period_ms, f"control period {control_period_ms:g} ms", palette.GOAL)
    axes[-1].set(xscale="log", xlim=(edges[0], edges[-1]))
    axes[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[-1].xaxis.set_minor_formatter(NullFormatter())
    axes[-1].set_xlabel("Time [ms], logarithmic")
    figure.supylabel(f"{len(samples):,} decisions", fontsize=9.5, color=palette.INK_SOFT)
    return figure


def _draw_part(
    ax: Axes, values: pd.Series, edges: np.ndarray, name: str, color: str, summary: dict[str, float]
) -> None:
    ax.hist(values, bins=edges.tolist(), color=color, alpha=0.8, lw=0)
    panel_title(ax, name, color=color, pad=3)
    numbers = "   ".join(f"{statistic} {summary[statistic]:.3g}" for statistic in STATISTICS)
    ax.set_title(f"{numbers} ms", loc="right", fontsize=8, color=palette.INK_SOFT, pad=3)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def label_line(ax: Axes, value: float, text: str, color: str) -> None:
    """Write text to the left of a vertical line at `value`, in the units of the x axis."""
    label(ax, text, (value, 0.62), (-5, 0), xycoords=ax.get_xaxis_transform(), ha="right", color=color)
