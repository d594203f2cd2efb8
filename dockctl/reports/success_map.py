"""Success over start positions around a pose: the harbor in cells, and success against distance and heading.

Only free starts count; one that lies in an obstacle, or outside of the water, is blocked.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Circle, Patch, Rectangle
from matplotlib.ticker import MultipleLocator, PercentFormatter
from numpy.typing import NDArray

from dockctl.analysis.statistics import wilson_interval
from dockctl.analysis.success_map import (
    EPS,
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.analysis.trajectories import pose_label
from dockctl.drawing import palette
from dockctl.drawing.scene import Scene
from dockctl.reports import plan_view
from dockctl.reports.style import HALO, legend_above, titled_figure
from dockctl.scenarios.schema import Task

Floats = NDArray[np.float64]

HEADINGS_DEG = (SMALL_OFFSET_DEG, 45.0, 180.0)
DISTANCES_M = (3.0, 6.0, 10.0)
"""Largest offsets of the curves' groups."""
THESIS_M = {3.0: "§4.4", 5.0: "§5.2"}
"""Distances beyond which the thesis' policy fails, and where it says so."""
COLORS = (palette.MEAN, palette.SECOND_MEAN, palette.PURPLE)
BLOCKED = "#8C99A3"
ACROSS = 4


def map_figure(table: pd.DataFrame, plan: Scene, task: Task, caption: str) -> Figure:
    """A panel of cells for every heading, and under them success against distance and against heading.

    Args:
        table: columns `COLUMNS`, a row a start.
        plan: the harbor from above.
        task: its goals are drawn.
        caption: whose map it is.
    """
    headings = [float(value) for value in table["dheading_deg"].unique()]
    reach, free = half_width(table), free_starts(table)
    middle = table[(table["dx_m"] == 0) & (table["dy_m"] == 0)].iloc[0]
    pose = pose_label(middle["x_m"], middle["y_m"], middle["heading_deg"] - middle["dheading_deg"])
    columns, rows = min(ACROSS, len(headings)), -(-len(headings) // ACROSS)
    goals = np.array([[p.x_m, p.y_m] for p in (task.final, task.intermediate) if p is not None])
    view = _view(plan, table, goals)
    width = 13.0
    panels = rows * ((width - 0.4) / columns * (view[3] - view[1]) / (view[2] - view[0]) * 0.93 + 0.45)
    straight, askew = (
        format_radius(success_radius(within_heading(free, limit), reach)) for limit in (0, SMALL_OFFSET_DEG)
    )
    figure = titled_figure(
        f"Where it docks from: starts within ±{reach:g} m of {pose}",
        f"{caption}; {len(free):,} free starts, {free['docked'].mean():.0%} dock. Success radius, up to which"
        f" every free start docks (dashed): {straight} with the heading of the pose, {askew} up to 20° askew",
        (width, panels + 4.2),
    )
    grid = figure.add_gridspec(2, 1, height_ratios=(panels + 0.4, 3.2))
    upper, lower = (figure.add_subfigure(grid[row, 0]) for row in range(2))
    axes = np.atleast_1d(upper.subplots(rows, columns, sharex=True, sharey=True)).ravel()
    for ax, heading in zip(axes, headings, strict=False):
        part = table[table["dheading_deg"] == heading]
        plan_view.draw_harbor(ax, plan, view)
        draw_cells(ax, part, plan.hull, reach)
        for goal in goals[:1]:
            ax.plot(*goal, marker="P", ms=6, color=palette.GOAL, mec="white", mew=0.6, zorder=6)
        ours = free_starts(part)
        ax.set_title(
            f"{_signed(heading)}   {ours['docked'].sum()} of {len(ours)}",
            loc="left", fontsize=8.5, fontweight="bold", color=palette.INK,
        )  # fmt: skip
        ax.label_outer()
    for ax in axes[len(headings) :]:
        ax.set_visible(False)
    _outcome_key(upper)
    left, right = lower.subplots(1, 2)
    draw_by_distance(left, free, reach)
    draw_by_heading(right, free)
    return figure


def draw_cells(ax: Axes, part: pd.DataFrame, hull: Floats, reach_m: float) -> None:
    """The starts of one heading as cells in the color of their outcome, the boat in the middle of them."""
    side = _spacing(part)
    blocked = part["blocked"].to_numpy(bool)
    for name, color in palette.OUTCOMES.items():
        cells = part[~blocked & (part["outcome"] == name).to_numpy()]
        ax.add_collection(_squares(cells, 0.9 * side, fc=color, ec="white", lw=0.5, alpha=0.88, zorder=3))
    ax.add_collection(
        _squares(part[blocked], 0.9 * side, fc="none", ec=BLOCKED, lw=0.5, hatch="//////", zorder=3)
    )
    middle = part[(part["dx_m"] == 0) & (part["dy_m"] == 0)].iloc[0]
    place = np.array([middle["x_m"], middle["y_m"], np.radians(middle["heading_deg"])])
    plan_view.draw_boat(ax, hull, place, palette.INK, fill=0.25, lw=1.2)
    plan_view.draw_heading(ax, hull, place, palette.INK)
    if radius := success_radius(free_starts(part), reach_m):
        ax.add_patch(
            Circle(
                (place[0], place[1]), radius, fc="none", ec=palette.INK,
                lw=1.3, ls=(0, (4, 2)), zorder=7, path_effects=HALO,
            )
        )  # fmt: skip


def draw_by_distance(ax: Axes, free: pd.DataFrame, reach_m: float) -> None:
    """Success against the distance between start and pose, for nested groups of headings."""
    step = _spacing(free)
    offset = (free["offset_m"] / step).round() * step
    near = free.assign(offset=offset)[offset <= reach_m + EPS]
    widest = near["dheading_deg"].abs().max()
    groups = [
        (_askew(limit), within_heading(near, limit))
        for limit in _limits(near["dheading_deg"].abs(), HEADINGS_DEG, widest)
    ]
    _curves(ax, groups, "offset")
    for distance, section in THESIS_M.items():
        if distance <= reach_m:
            ax.axvline(distance, color=palette.INK_SOFT, lw=1.0, ls=(0, (1, 2)), zorder=1)
            ax.annotate(
                section, (distance, 0.02), xytext=(3, 0), textcoords="offset points", fontsize=7.5,
                color=palette.INK_SOFT, path_effects=HALO,
            )  # fmt: skip
    ax.set_xlim(0, 1.01 * reach_m or 1.0)
    ax.set_xlabel("Distance of the start from the pose [m]   (dotted: beyond it the thesis' policies fail)")


def draw_by_heading(ax: Axes, free: pd.DataFrame) -> None:
    """Success against the heading's offset, for nested groups of distances."""
    groups = [
        (f"within {limit:g} m", free[free["offset_m"] <= limit + EPS])
        for limit in _limits(free["offset_m"], DISTANCES_M, free["offset_m"].max())
    ]
    _curves(ax, groups, "dheading_deg")
    low, high = free["dheading_deg"].min(), free["dheading_deg"].max()
    ax.set_xlim(low - 4, high + 4)
    if high - low >= 90:
        ax.xaxis.set_major_locator(MultipleLocator(45))
    ax.set_xlabel("Heading of the start against that of the pose [°]")


def _curves(ax: Axes, groups: Sequence[tuple[str, pd.DataFrame]], column: str) -> None:
    for (_, group), color in zip(groups, COLORS, strict=False):
        counts = group.groupby(column)["docked"].agg(["sum", "size"])
        at = counts.index.to_numpy(float)
        bounds = [wilson_interval(int(k), int(n)) for k, n in counts.itertuples(index=False)]
        low, high = np.array(bounds).T
        ax.fill_between(at, low, high, color=color, alpha=0.1, lw=0)
        ax.plot(
            at, counts["sum"] / counts["size"], color=color, marker="o", ms=4, mec="white", mew=0.7, zorder=3
        )
    ax.set_ylim(0, 1.02)
    ax.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    ax.set_ylabel("Starts that dock, with 95 % interval")
    legend_above(ax, [(name, color) for (name, _), color in zip(groups, COLORS, strict=False)], columns=3)


def _limits(values: pd.Series, wanted: Sequence[float], widest: float) -> list[float]:
    """Of the wanted limits those that part the values, and the widest in place of those beyond it."""
    limits = sorted({min(limit, widest) for limit in wanted})
    sizes = [(values <= limit + EPS).sum() for limit in limits]
    return [limit for i, limit in enumerate(limits) if sizes[i] > (sizes[i - 1] if i else 0)]


def _squares(cells: pd.DataFrame, side: float, **look: Any) -> PatchCollection:
    corners = zip(cells["x_m"] - side / 2, cells["y_m"] - side / 2, strict=True)
    return PatchCollection([Rectangle(corner, side, side) for corner in corners], **look)


def _spacing(table: pd.DataFrame) -> float:
    """Distance between neighbouring starts [m]."""
    places = np.sort(table["dx_m"].unique())
    return float(np.diff(places).min()) if len(places) > 1 else 1.0


def _view(plan: Scene, table: pd.DataFrame, goals: Floats) -> plan_view.Bounds:
    """The cells and the goals, with a margin."""
    margin = _spacing(table) / 2 + 0.6
    points = np.concatenate([table[["x_m", "y_m"]].to_numpy(float), goals])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _outcome_key(figure: FigureBase) -> None:
    handles = [Patch(fc=color, label=name) for name, color in palette.OUTCOMES.items()]
    handles.append(Patch(fc="white", ec=BLOCKED, hatch="//////", label="blocked: no room for the boat"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _askew(limit_deg: float) -> str:
    if limit_deg == 0:
        return "heading of the pose"
    return "all headings" if limit_deg >= 180 else f"up to {limit_deg:g}° askew"


def _signed(degrees: float) -> str:
    if degrees == 0:
        return "heading of the pose"
    return "turned by 180°" if abs(degrees) == 180 else f"turned by {degrees:+g}°".replace("-", "−")
