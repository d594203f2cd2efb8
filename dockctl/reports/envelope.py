"""Operating envelope: success over the values of each factor, one panel each (``dockctl envelope``)."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dockctl.drawing import palette
from dockctl.reports.style import draw_share, legend_above, make_figure, panels, percent

SHOWN = ("docked", "collision")


def envelope_figure(table: pd.DataFrame, labels: Mapping[str, str], caption: str) -> Figure:
    """Draw the share that docks and the share that collides over the values of each factor.

    Args:
        table: columns `dockctl.runs.tables.ENVELOPE`.
        labels: labels of the factors' values.
        caption: the policy.
    """
    factors = list(table["factor"].unique())
    columns = min(3, len(factors))
    rows = -(-len(factors) // columns)
    episodes = int(table["episodes"].max())
    figure = make_figure(
        "Operating envelope",
        f"{caption}; {episodes:,} random starts for each value, with 95 % intervals; one factor at a time",
        (4.3 * columns, 2.9 * rows + 0.7),
    )
    for ax, factor in zip(panels(figure, len(factors), columns), factors, strict=True):
        part = table[table["factor"] == factor]
        for outcome in SHOWN:
            draw_share(ax, part["value"], part[outcome], part["episodes"], palette.OUTCOMES[outcome])
        ax.set_ylim(0, 1.02)
        ax.set_xlim(part["value"].min(), part["value"].max() * 1.02 or 1.0)
        percent(ax.yaxis)
        if part["value"].max() < 5 and (part["value"] % 1 == 0).all():
            ax.xaxis.set_major_locator(MaxNLocator(integer=True))
        ax.set_xlabel(labels[factor][:1].upper() + labels[factor][1:])
        legend_above(ax, [(outcome, palette.OUTCOMES[outcome]) for outcome in SHOWN])
    return figure
