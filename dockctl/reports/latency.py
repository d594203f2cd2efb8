"""How long a decision takes, against the thesis' forward pass and the control period (thesis Fig. 4.38)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from dockctl.analysis.latency import PARTS, STATISTICS, THESIS_FORWARD_MS, summarize
from dockctl.drawing import palette
from dockctl.reports.style import HALO, titled_figure

COLORS = {
    "scan_ms": palette.BLUE,
    "state_ms": palette.PURPLE,
    "forward_ms": palette.DOCKED,
    "decision_ms": palette.INK,
}


def latency_figure(samples: pd.DataFrame, subtitle: str, control_period_ms: float) -> Figure:
    """Histograms on one logarithmic axis, with the thesis' forward pass and the control period marked.

    Args:
        samples: a row a decision, columns `PARTS` [ms].
        subtitle: what was timed.
        control_period_ms: the time in which a decision must be made.
    """
    figure = titled_figure("How long the boat takes to decide", subtitle, (7.8, 5.6))
    axes = figure.subplots(len(PARTS), sharex=True)
    least, most = float(samples.to_numpy().min()), float(max(samples.to_numpy().max(), control_period_ms))
    edges = np.geomspace(max(least, 1e-4) / 1.5, 2.5 * most, 140)
    summary = summarize(samples)
    for ax, (part, name) in zip(axes, PARTS.items(), strict=True):
        _draw_part(ax, samples[part], edges, name, COLORS[part], summary[part])
        ax.axvline(control_period_ms, color=palette.GOAL, lw=1.3, ls=(0, (4, 2)))
        if part == "forward_ms":
            ax.axvline(THESIS_FORWARD_MS, color=palette.YELLOW, lw=1.6)
            _name_line(ax, THESIS_FORWARD_MS, f"thesis {THESIS_FORWARD_MS:g} ms", palette.YELLOW, 0.62)
    _name_line(axes[0], control_period_ms, f"control period {control_period_ms:g} ms", palette.GOAL, 0.62)
    axes[-1].set_xscale("log")
    axes[-1].set_xlim(edges[0], edges[-1])
    axes[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes[-1].xaxis.set_minor_formatter(NullFormatter())
    axes[-1].set_xlabel("Time [ms], logarithmic")
    figure.supylabel(f"{len(samples):,} decisions", fontsize=9.5, color=palette.INK_SOFT)
    return figure


def _draw_part(
    ax: Axes, values: pd.Series, edges: np.ndarray, name: str, color: str, row: dict[str, float]
) -> None:
    ax.hist(values, bins=edges.tolist(), color=color, alpha=0.8, lw=0)
    ax.set_title(name, loc="left", fontsize=9, fontweight="bold", color=color, pad=3)
    ax.set_title(
        "   ".join(f"{name} {row[name]:.3g}" for name in STATISTICS) + " ms",
        loc="right",
        fontsize=8,
        color=palette.INK_SOFT,
        pad=3,
    )
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)


def _name_line(ax: Axes, value: float, text: str, color: str, height: float) -> None:
    ax.annotate(
        text,
        (value, height),
        xycoords=ax.get_xaxis_transform(),
        xytext=(-5, 0),
        textcoords="offset points",
        ha="right",
        fontsize=8,
        color=color,
        path_effects=HALO,
    )
