"""Plan view of the harbor with poses, boats and tracks (thesis Figs. 3.13-3.15, 4.4, 4.14, 4.24)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch, Polygon, Rectangle
from matplotlib.transforms import ScaledTranslation

from dockctl.drawing import palette
from dockctl.drawing.scene import Scene, strokes, water
from dockctl.geometry import Floats, pose_array, pose_label, to_world
from dockctl.reports.style import HALO, label, legend_above
from dockctl.scenarios.base import Pose
from dockctl.scenarios.schema import Task, Tolerance

Bounds = tuple[float, float, float, float]

INTERVALS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # between outlines
MOST_OUTLINES = 12  # along the longest path
QUAY_M = 3.0  # width of the strip of land around the water
CLOSE_MARGIN_M = 4.5  # around the points of a close view
FLOWS = {"current": palette.SINGLE, "wind": palette.INK_SOFT}
FLOW_PT = 16.0  # length of their arrows
SCALE_BARS_M = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


@dataclass(frozen=True)
class Track:
    """Trajectory of a greedy episode: start pose as text, color in every figure, and rows of the table."""

    label: str
    color: str
    table: pd.DataFrame

    @property
    def docked(self) -> bool:
        return bool(self.table["outcome"].iloc[-1] == "docked")

    @property
    def switch(self) -> int | None:
        """First row after the intermediate pose; None if the phase never changes."""
        changes = np.flatnonzero(np.diff(self.table["phase"].to_numpy()))
        return int(changes[0]) + 1 if len(changes) else None


def tolerance_spans(
    tracks: Sequence[Track], task: Task
) -> list[tuple[float | None, float | None, Tolerance]]:
    """Return the tolerances of the goals with start and end [s] of their phases; None is an end of the axis.

    With several tracks, the two phases may overlap.
    """
    changes = [float(t.table["time_s"].iloc[row]) for t in tracks if (row := t.switch) is not None]
    if not changes:
        in_first = tracks[0].table["phase"].iloc[-1] == 0
        return [(None, None, task.intermediate_tolerance if in_first else task.final_tolerance)]
    return [(None, max(changes), task.intermediate_tolerance), (min(changes), None, task.final_tolerance)]


def split_tracks(trajectories: pd.DataFrame) -> list[Track]:
    """Split ``trajectories.csv`` by start pose; one track is blue, several have the colors of Table 4.3."""
    groups = [rows.reset_index(drop=True) for _, rows in trajectories.groupby("pose", sort=False)]
    colors = palette.SERIES if len(groups) > 1 else (palette.SINGLE,)
    return [
        Track(pose_label(*rows.loc[0, ["x_m", "y_m", "heading_deg"]]), colors[i % len(colors)], rows)
        for i, rows in enumerate(groups)
    ]


def draw_harbor(ax: Axes, scene: Scene, view: Bounds) -> None:
    """Draw the harbor within `view`, (x_min, y_min, x_max, y_max) [m]."""
    drawn = [stroke for stroke in strokes(scene) if _overlaps(stroke.xy, view)]
    shapes = PolyCollection(
        [stroke.xy for stroke in drawn],
        fc=[stroke.fill or "none" for stroke in drawn],
        ec=[stroke.edge or "none" for stroke in drawn],
        lw=0.35,
        zorder=1,
    )
    ax.add_collection(shapes)
    ax.set(xlim=view[::2], ylim=view[1::2], xlabel="x [m]", ylabel="y [m]", aspect="equal")
    ax.set_facecolor(palette.WATER)
    ax.grid(False)
    ax.spines[:].set_visible(True)
    ax.tick_params(length=3.0)


def draw_compass(ax: Axes, view: Bounds) -> None:
    """Draw a scale bar and an arrow to +y (north) in the lower right corner."""
    width, height = view[2] - view[0], view[3] - view[1]
    length = max((bar for bar in SCALE_BARS_M if bar <= 0.2 * width), default=SCALE_BARS_M[0])
    unit = 0.01 * max(width, height)  # scales the arrow and the height of the bar with the view
    right, bottom = view[2] - 2.5 * unit, view[1] + 2.5 * unit
    left = right - length
    corner, rounding = (left - 5.5 * unit, bottom - 0.5 * unit), f"round,pad={unit},rounding_size={unit}"
    plate = FancyBboxPatch(corner, length + 6 * unit, 5 * unit, boxstyle=rounding, fc="white", ec="none")
    ax.add_patch(plate).set(alpha=0.8, zorder=8)
    for x, color in ((left, palette.INK), (left + length / 2, "white")):
        half = Rectangle((x, bottom), length / 2, 0.8 * unit, fc=color, ec=palette.INK, lw=0.6, zorder=9)
        ax.add_patch(half)
    foot, tip = (left - 3.5 * unit, bottom), (left - 3.5 * unit, bottom + 3 * unit)
    ax.add_patch(_arrow(foot, tip, palette.INK, size=9.0, zorder=9))
    style: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 7.5, "zorder": 9}
    ax.text((left + right) / 2, bottom + 1.6 * unit, f"{length:g} m", **style)
    ax.text(*tip, "N", **style)


def draw_boat(
    ax: Axes,
    hull: Floats,
    pose: Floats,
    color: str,
    *,
    fill: float = 0.0,
    dashed: bool = False,
    lw: float = 1.1,
) -> None:
    """Draw the outline of the boat at a pose (3,) [m, m, rad], filled with opacity `fill`."""
    outline = to_world(hull, pose)
    if fill:
        ax.add_patch(Polygon(outline, fc=color, ec="none", alpha=fill, zorder=4))
    ls = (0, (2.2, 1.4)) if dashed else "-"
    ax.add_patch(Polygon(outline, fc="none", ec=color, lw=lw, ls=ls, zorder=5, joinstyle="round"))


def draw_heading(ax: Axes, hull: Floats, pose: Floats, color: str) -> None:
    """Draw an arrow from the reference point of the boat to a point just ahead of the bow.

    Args:
        hull: outline (k, 2) in the body frame [m].
        pose: x, y [m] and heading [rad], (3,).
    """
    reach = hull[:, 0].max() + 0.9
    head = (pose[0] + reach * math.cos(pose[2]), pose[1] + reach * math.sin(pose[2]))
    ax.add_patch(_arrow((pose[0], pose[1]), head, color, size=8.0, zorder=6))


def _arrow(
    foot: tuple[float, float], head: tuple[float, float], color: str, size: float, zorder: float
) -> FancyArrowPatch:
    shape: dict[str, Any] = {"arrowstyle": "-|>", "mutation_scale": size, "shrinkA": 0, "shrinkB": 0}
    return FancyArrowPatch(foot, head, color=color, lw=1.2, zorder=zorder, **shape)


def draw_goals(ax: Axes, hull: Floats, task: Task, *, named: bool = True) -> None:
    """Draw the final pose and the intermediate pose, if any, with their tolerance circles.

    Args:
        hull: outline (k, 2) in the body frame [m].
        named: write the name of each.
    """
    goals = [("berth", task.final, task.final_tolerance)]
    if task.intermediate is not None:
        goals.append(("intermediate pose", task.intermediate, task.intermediate_tolerance))
    for name, pose, tolerance in goals:
        eta = pose_array(pose)
        circle = {"radius": tolerance.distance_m, "lw": 0.9, "zorder": 3}
        ax.add_patch(Circle((pose.x_m, pose.y_m), fc=palette.GOAL, ec="none", alpha=0.16, **circle))
        ax.add_patch(Circle((pose.x_m, pose.y_m), fc="none", ec=palette.GOAL, ls=(0, (1, 1.6)), **circle))
        draw_boat(ax, hull, eta, palette.GOAL, dashed=True, lw=1.3)
        draw_heading(ax, hull, eta, palette.GOAL)
        if named:
            draw_label(ax, hull, eta, name, palette.GOAL, apart_m=tolerance.distance_m)


def draw_label(
    ax: Axes,
    hull: Floats,
    pose: Floats,
    text: str,
    color: str,
    *,
    below: bool = False,
    apart_m: float = 0.0,
) -> None:
    """Write text above or below a boat, at least `apart_m` from its reference point.

    Args:
        hull: outline (k, 2) in the body frame [m].
        pose: x, y [m] and heading [rad], (3,).
    """
    ys = np.array([*to_world(hull, pose)[:, 1], pose[1] - apart_m, pose[1] + apart_m])
    y, shift, side = (ys.min(), -5, "top") if below else (ys.max(), 5, "bottom")
    label(
        ax, text, (pose[0], y), (0, shift), ha="center", va=side, fontweight="bold", color=color, zorder=10,
        annotation_clip=True,
    )  # fmt: skip


def draw_flows(ax: Axes, velocities: Mapping[str, Sequence[float]]) -> list[Artist]:
    """Draw current and wind as arrows in the upper left corner.

    Args:
        velocities: x and y [m/s] of some of `FLOWS`, by name.

    Returns:
        The arrows and their labels.
    """
    below, drawn = 22.0, list[Artist]()  # points from the corner
    figure = ax.get_figure(root=True)
    assert figure is not None
    for name, color in FLOWS.items():
        if name not in velocities:
            continue
        x, y = velocities[name]
        speed = math.hypot(x, y)
        middle = ax.transAxes + ScaledTranslation(22 / 72, -below / 72, figure.dpi_scale_trans)
        place: dict[str, Any] = {"xy": (0.0, 1.0), "xycoords": middle, "textcoords": "offset points"}
        if speed > 0:
            arrow = {"arrowstyle": "-|>", "color": color, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
            foot = (-FLOW_PT * x / speed, -FLOW_PT * y / speed)
            drawn.append(ax.annotate("", xytext=foot, arrowprops=arrow, zorder=9, **place))
        text = ax.annotate(f"{name} {speed:.2g} m/s", xytext=(22, -3), **place)
        text.set(color=color, fontsize=7.5, zorder=9, path_effects=HALO)
        drawn.append(text)
        below += 2 * FLOW_PT + 4
    return drawn


def mean_flows(table: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Return the mean velocities [m/s] of the flows in a trajectory, by name."""
    return {
        name: (float(table[f"{name}_x_mps"].mean()), float(table[f"{name}_y_mps"].mean()))
        for name in FLOWS
        if f"{name}_x_mps" in table
    }


def common_flows(tables: Sequence[pd.DataFrame]) -> dict[str, tuple[float, float]]:
    """Return those of `mean_flows` that are equal in all trajectories, by name."""
    first, *others = map(mean_flows, tables)
    return {
        name: mean
        for name, mean in first.items()
        if all(np.allclose(other[name], mean, rtol=0, atol=1e-3) for other in others)
    }


def draw_paths(ax: Axes, scene: Scene, tracks: Sequence[Track], task: Task) -> None:
    """Draw paths with the outline of the boat at equal time intervals (Fig. 4.4)."""
    interval = outline_interval(tracks)
    draw_goals(ax, scene.hull, task)
    for track in tracks:
        table = track.table
        poses = np.column_stack([table["x_m"], table["y_m"], np.radians(table["heading_deg"])])
        path: dict[str, Any] = {"color": track.color, "lw": 1.6, "zorder": 6, "path_effects": HALO}
        ax.plot(poses[:, 0], poses[:, 1], label=track.label, **path)
        time = table["time_s"].to_numpy(float) - table["time_s"].iloc[0]
        rows = np.searchsorted(time, np.arange(0, time[-1] + 1e-9, interval) - 1e-9)
        is_crowded = len(tracks) > 1  # outlines overlap and must not hide the paths
        for row in rows[1:]:
            draw_boat(
                ax,
                scene.hull,
                poses[row],
                track.color,
                fill=0.0 if is_crowded else 0.14,
                lw=0.45 if is_crowded else 0.7,
            )
        draw_boat(ax, scene.hull, poses[0], track.color, fill=0.35, lw=1.4)
        draw_heading(ax, scene.hull, poses[0], track.color)
        draw_boat(ax, scene.hull, poses[-1], track.color, fill=0.55, lw=1.4)
    draw_flows(ax, common_flows([track.table for track in tracks]))
    if len(tracks) == 1:
        draw_label(ax, scene.hull, poses[0], f"start {tracks[0].label}", tracks[0].color, below=True)
    legend_above(ax, [(track.label, track.color) for track in tracks])


def outline_interval(tracks: Iterable[Track]) -> float:
    """Return a round interval between outlines [s], with at most `MOST_OUTLINES` on the longest track."""
    longest = max(float(track.table["time_s"].iloc[-1] - track.table["time_s"].iloc[0]) for track in tracks)
    return next((seconds for seconds in INTERVALS_S if longest / seconds <= MOST_OUTLINES), INTERVALS_S[-1])


def draw_poses(ax: Axes, scene: Scene, task: Task, tests: Sequence[Pose], *, named: bool = True) -> None:
    """Draw the initial, intermediate and final poses of a task, and further evaluation poses."""
    draw_goals(ax, scene.hull, task, named=named)
    starts = {(pose.x_m, pose.y_m, pose.heading_deg) for pose in task.initial}
    others = [pose for pose in tests if (pose.x_m, pose.y_m, pose.heading_deg) not in starts]
    for poses, color, fill in ((others, palette.PURPLE, 0.10), (task.initial, palette.BLUE, 0.40)):
        for pose in poses:
            draw_boat(ax, scene.hull, pose_array(pose), color, fill=fill)
            draw_heading(ax, scene.hull, pose_array(pose), color)
    if not named:
        return
    lowest = pose_array(min(task.initial, key=lambda pose: pose.y_m))
    draw_label(
        ax, scene.hull, lowest, "start" if len(task.initial) == 1 else "starts", palette.BLUE, below=True
    )
    if others:
        highest = pose_array(max(others, key=lambda pose: pose.y_m))
        draw_label(ax, scene.hull, highest, "evaluation poses", palette.PURPLE)


def whole_view(scene: Scene) -> Bounds:
    """Return the water and a strip of the quays around it, (x_min, y_min, x_max, y_max) [m]."""
    x_min, y_min, x_max, y_max = water(scene)
    return x_min - QUAY_M, y_min - QUAY_M, x_max + QUAY_M, y_max + QUAY_M


def extended(scene: Scene, points: Floats) -> Scene:
    """Return the scene with bounds that include `points` (k, 2) [m]; a harbor from mesh files may not."""
    x_min, y_min, x_max, y_max = scene.bounds
    low, high = points.min(axis=0), points.max(axis=0)
    if (low >= (x_min, y_min)).all() and (high <= (x_max, y_max)).all():
        return scene
    bounds = (*np.minimum(low, (x_min, y_min)).tolist(), *np.maximum(high, (x_max, y_max)).tolist())
    return replace(scene, bounds=bounds)


def close_view(scene: Scene, points: Floats, aspect: tuple[float, float] = (0.85, 1.75)) -> Bounds:
    """Return a view around `points` (k, 2) [m], clipped to the harbor.

    Args:
        aspect: smallest and largest ratio of width to height.
    """
    low, high = points.min(axis=0) - CLOSE_MARGIN_M, points.max(axis=0) + CLOSE_MARGIN_M
    width, height = high - low
    center = (low + high) / 2
    size = np.array([max(width, aspect[0] * height), max(height, width / aspect[1])])
    whole = np.array(whole_view(scene))
    size = np.minimum(size, whole[2:] - whole[:2])
    low = np.clip(center - size / 2, whole[:2], whole[2:] - size)
    return float(low[0]), float(low[1]), float(low[0] + size[0]), float(low[1] + size[1])


def task_points(task: Task, tests: Sequence[Pose] = ()) -> Floats:
    """Return the positions of the poses of a task and of its evaluation poses, (k, 2) [m]."""
    poses = [*task.initial, *tests, task.final, *([task.intermediate] if task.intermediate else [])]
    return np.array([[pose.x_m, pose.y_m] for pose in poses])


def pose_names(poses: Iterable[Pose]) -> str:
    """Return poses as text: ``(20, 2, 160°), (20, 0, 180°)``."""
    return ", ".join(pose_label(pose.x_m, pose.y_m, pose.heading_deg) for pose in poses)


def _overlaps(xy: Floats, view: Bounds) -> bool:
    low, high = xy.min(axis=0), xy.max(axis=0)
    return bool((high >= view[:2]).all() and (low <= view[2:]).all())
