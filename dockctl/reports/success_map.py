"""Success map: outcome over start positions, and success by distance and heading offset (``dockctl map``).

Only free starts count; a start at which the boat would touch an obstacle or leave the water is blocked.
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
from matplotlib.ticker import MultipleLocator

from dockctl.analysis.success_map import (
    EPS,
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    half_width,
    success_radius,
    within_distance,
    within_heading,
)
from dockctl.drawing import palette
from dockctl.drawing.scene import Scene
from dockctl.geometry import Floats, pose_label
from dockctl.reports import plan_view
from dockctl.reports.style import HALO, draw_share, legend_above, make_figure, panel_title, panels, percent
from dockctl.scenarios.schema import Task

HEADING_LIMITS_DEG = (SMALL_OFFSET_DEG, 45.0, 180.0)
DISTANCE_LIMITS_M = (3.0, 6.0, 10.0)
"""Maximum offsets of the groups for which success is drawn."""
COLORS = (palette.MEAN, palette.SECOND_MEAN, palette.PURPLE)
BLOCKED_COLOR, BLOCKED_HATCH = "#8C99A3", "//////"
MOST_COLUMNS = 4


def map_figure(table: pd.DataFrame, plan: Scene, task: Task, caption: str) -> Figure:
    """Draw one panel of cells per heading offset; below, success by distance and by heading offset.

    Args:
        table: columns `dockctl.analysis.success_map.COLUMNS`, one row per start.
        plan: plan view of the harbor.
        task: its goals are drawn.
        caption: the policy.
    """
    headings = [float(value) for value in table["dheading_deg"].unique()]
    limit, free = half_width(table), free_starts(table)
    center = _center(table)
    pose = pose_label(center["x_m"], center["y_m"], center["heading_deg"] - center["dheading_deg"])
    columns, rows = min(MOST_COLUMNS, len(headings)), -(-len(headings) // MOST_COLUMNS)
    goals = np.array([[p.x_m, p.y_m] for p in (task.final, task.intermediate) if p is not None])
    view = _view(table, goals)
    width = 13.0
    height = rows * ((width - 0.4) / columns * (view[3] - view[1]) / (view[2] - view[0]) * 0.93 + 0.45)
    straight, small = (
        format_radius(success_radius(within_heading(free, degrees), limit))
        for degrees in (0, SMALL_OFFSET_DEG)
    )
    parts = [table[table["dheading_deg"] == heading] for heading in headings]
    dashed = " (dashed)" if any(success_radius(free_starts(part), limit) for part in parts) else ""
    figure = make_figure(
        f"Success by start pose, within ±{limit:g} m of {pose}",
        f"{caption}; {len(free):,} free starts, {free['docked'].mean():.0%} dock. Success radius, up to which"
        f" every free start docks{dashed}: {straight} with the heading of the pose, {small} with heading"
        f" offsets up to {SMALL_OFFSET_DEG:g}°",
        (width, height + 4.2),
    )
    grid = figure.add_gridspec(2, 1, height_ratios=(height + 0.4, 3.2))
    upper, lower = (figure.add_subfigure(grid[row, 0]) for row in range(2))
    axes = panels(upper, len(headings), columns, sharex=True, sharey=True)
    for ax, heading, part in zip(axes, headings, parts, strict=True):
        plan_view.draw_harbor(ax, plan, view)
        draw_cells(ax, part, plan.hull, limit)
        ax.plot(*goals[0], marker="P", ms=6, color=palette.GOAL, mec="white", mew=0.6, zorder=6)
        counted = free_starts(part)
        counts = f"{counted['docked'].sum()} of {len(counted)}"
        panel_title(ax, f"{_offset_text(heading)}   {counts}", fontsize=8.5)
        ax.label_outer()
    _add_outcome_legend(upper)
    left, right = lower.subplots(1, 2)
    draw_by_distance(left, free, limit)
    draw_by_heading(right, free)
    return figure


def draw_cells(ax: Axes, part: pd.DataFrame, hull: Floats, limit_m: float) -> None:
    """Draw the starts with one heading offset as cells colored by outcome, and the boat at the center.

    Args:
        part: rows of these starts, columns `dockctl.analysis.success_map.COLUMNS`.
        hull: outline (k, 2) in the body frame [m].
        limit_m: half-width of the map [m].
    """
    side = 0.9 * spacing(part)
    blocked = part["blocked"].to_numpy(bool)
    for name, color in palette.OUTCOMES.items():
        cells = part[~blocked & (part["outcome"] == name).to_numpy()]
        ax.add_collection(_squares(cells, side, fc=color, ec="white", lw=0.5, alpha=0.88, zorder=3))
    ax.add_collection(
        _squares(part[blocked], side, fc="none", ec=BLOCKED_COLOR, lw=0.5, hatch=BLOCKED_HATCH, zorder=3)
    )
    center = _center(part)
    pose = np.array([center["x_m"], center["y_m"], np.radians(center["heading_deg"])])
    plan_view.draw_boat(ax, hull, pose, palette.INK, fill=0.25, lw=1.2)
    plan_view.draw_heading(ax, hull, pose, palette.INK)
    if radius := success_radius(free_starts(part), limit_m):
        ax.add_patch(
            Circle(
                (pose[0], pose[1]), radius, fc="none", ec=palette.INK,
                lw=1.3, ls=(0, (4, 2)), zorder=7, path_effects=HALO,
            )
        )  # fmt: skip


def draw_by_distance(ax: Axes, free: pd.DataFrame, limit_m: float) -> None:
    """Draw success over the distance from the pose, for nested groups of heading offsets."""
    step = spacing(free)
    offset = (free["offset_m"] / step).round() * step
    near = free.assign(offset=offset)[offset <= limit_m + EPS]
    largest = near["dheading_deg"].abs().max()
    groups = [
        (_limit_text(limit), within_heading(near, limit))
        for limit in _limits(near["dheading_deg"].abs(), HEADING_LIMITS_DEG, largest)
    ]
    _draw_success(ax, groups, "offset")
    ax.set_xlim(0, 1.01 * limit_m or 1.0)
    ax.set_xlabel("Distance of the start from the pose [m]")


def draw_by_heading(ax: Axes, free: pd.DataFrame) -> None:
    """Draw success over the heading offset, for nested groups of distances."""
    groups = [
        (f"within {limit:.3g} m", within_distance(free, limit))
        for limit in _limits(free["offset_m"], DISTANCE_LIMITS_M, free["offset_m"].max())
    ]
    _draw_success(ax, groups, "dheading_deg")
    low, high = free["dheading_deg"].min(), free["dheading_deg"].max()
    ax.set_xlim(low - 4, high + 4)
    if high - low >= 90:
        ax.xaxis.set_major_locator(MultipleLocator(45))
    ax.set_xlabel("Heading offset of the start from the pose [°]")


def _draw_success(ax: Axes, groups: Sequence[tuple[str, pd.DataFrame]], column: str) -> None:
    """Draw the share that docks at each value of a column, with Wilson intervals, one line per group."""
    for (_, group), color in zip(groups, COLORS, strict=False):
        counts = group.groupby(column)["docked"].agg(["sum", "size"]).reset_index()
        draw_share(ax, counts[column], counts["sum"], counts["size"], color)
    ax.set_ylim(0, 1.02)
    percent(ax.yaxis)
    ax.set_ylabel("Starts that dock, with 95 % interval")
    legend_above(ax, [(name, color) for (name, _), color in zip(groups, COLORS, strict=False)], columns=3)


def _limits(values: pd.Series, wanted: Sequence[float], largest: float) -> list[float]:
    """Return limits that select different groups of the values, each at most the largest value."""
    limits = sorted({min(limit, largest) for limit in wanted})
    sizes = [(values <= limit + EPS).sum() for limit in limits]
    return [limit for i, limit in enumerate(limits) if sizes[i] > (sizes[i - 1] if i else 0)]


def _center(table: pd.DataFrame) -> pd.Series:
    """Return the first start without a position offset."""
    return table[(table["dx_m"] == 0) & (table["dy_m"] == 0)].iloc[0]


def _squares(cells: pd.DataFrame, side: float, **style: Any) -> PatchCollection:
    corners = zip(cells["x_m"] - side / 2, cells["y_m"] - side / 2, strict=True)
    return PatchCollection([Rectangle(corner, side, side) for corner in corners], **style)


def spacing(table: pd.DataFrame) -> float:
    """Return the grid spacing [m]."""
    offsets = np.sort(table["dx_m"].unique())
    return float(np.diff(offsets).min()) if len(offsets) > 1 else 1.0


def _view(table: pd.DataFrame, goals: Floats) -> plan_view.Bounds:
    """Return the bounds of cells and goals with a margin, (x_min, y_min, x_max, y_max) [m]."""
    margin = spacing(table) / 2 + 0.6
    points = np.concatenate([table[["x_m", "y_m"]].to_numpy(float), goals])
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _add_outcome_legend(figure: FigureBase) -> None:
    handles = [Patch(fc=color, label=name) for name, color in palette.OUTCOMES.items()]
    handles.append(Patch(fc="white", ec=BLOCKED_COLOR, hatch=BLOCKED_HATCH, label="blocked by an obstacle"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))


def _limit_text(limit_deg: float) -> str:
    if limit_deg == 0:
        return "heading of the pose"
    return "all headings" if limit_deg >= 180 else f"heading offset up to {limit_deg:g}°"


def _offset_text(degrees: float) -> str:
    if degrees == 0:
        return "heading of the pose"
    return "180°" if abs(degrees) == 180 else f"{degrees:+g}°".replace("-", "−")
