"""Charts of the HTML report as plain data, with values from the tables; ``page/report.js`` draws them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from dockctl.analysis.episodes import (
    by_start,
    from_initial_poses,
    moving_average,
    smoothing_window,
    term_columns,
)
from dockctl.analysis.latency import PARTS, timed_parts
from dockctl.drawing import palette
from dockctl.drawing.scene import Scene, Stroke, strokes
from dockctl.geometry import Floats, pose_array
from dockctl.reports import plan_view
from dockctl.reports.learning import UPDATE_COLUMNS, term_colors, update_columns
from dockctl.reports.plan_view import Bounds, Track
from dockctl.reports.success_map import spacing
from dockctl.reports.trajectory import MEAN_STEPS
from dockctl.scenarios.schema import Task, Tolerance

Chart = dict[str, Any]
MOST_POINTS = 6_000
"""Maximum number of points in a series; of longer ones every second, third, ... row is drawn."""
BINS = 70
DENSE_STEPS = 240
"""Length of an episode above which command lines merge, so that their mean is also drawn."""
TRACK_TONES = tuple(f"s{i}" for i in range(len(palette.SERIES)))
"""Names of the colors of several tracks in the style sheet; they differ between the light and dark themes."""


def numbers(values: Iterable[Any]) -> list[float | int | None]:
    """Return the values as JSON numbers with six significant digits, as in the tables; NaN is None."""
    cells = (float(f"{value:.6g}") for value in np.asarray(values, float))
    return [None if not np.isfinite(cell) else int(cell) if cell == int(cell) else cell for cell in cells]


def thinned(table: pd.DataFrame, most: int = MOST_POINTS) -> pd.DataFrame:
    """Return at most `most` evenly spaced rows of a table, including the last one."""
    stride = max(1, -(-len(table) // most))
    return table.iloc[::-1].iloc[::stride].iloc[::-1]


def chart(title: str, x: str, y: str, series: Sequence[Mapping[str, Any]], **options: Any) -> Chart:
    """Return a chart of `series` over x; the options are those of ``page/report.js``."""
    return {"type": "xy", "title": title, "x": {"label": x}, "y": {"label": y}, "series": [*series]} | options


def series(
    name: str, tone: str, x: Iterable[Any], y: Iterable[Any], kind: str = "line", **more: Any
) -> Chart:
    """Return one series: `kind` is line, step, dots, stack or bars, `tone` a color of the style sheet."""
    return {"name": name, "tone": tone, "kind": kind, "x": numbers(x), "y": numbers(y), **more}


def training_charts(episodes: pd.DataFrame, task: Task) -> list[Chart]:
    """Return charts of return, outcomes, duration, reward terms, phase and exploration in training."""
    window = smoothing_window(episodes)
    charts = [
        _episode_chart("Return", "Return of the episode", episodes, "return"),
        _outcome_chart(episodes, window),
        _episode_chart("Duration", "Control steps", episodes, "steps", min=0),
    ]
    shown = thinned(episodes)
    if term_columns(episodes):
        means = [
            series(
                name, tone, shown["episode"], moving_average(episodes[f"reward_{name}"], window)[shown.index]
            )
            for name, tone in term_colors(episodes)
        ]
        charts.append(chart("Reward by term", "Episode", f"Mean of {window} episodes", means))
    if task.intermediate is not None:
        chosen = from_initial_poses(episodes)
        share = moving_average(chosen["phase"], smoothing_window(chosen))
        kept = thinned(chosen)
        line = series("reached it", "mean", kept["episode"], share[kept.index])
        title = "Intermediate pose reached"
        charts.append(
            chart(title, "Episode", f"Share of {smoothing_window(chosen)} episodes", [line], percent=True)
        )
    if episodes["epsilon"].notna().any():
        epsilon = series("ε", "mean", shown["episode"], shown["epsilon"])
        charts.append(chart("Exploration", "Episode", "ε, probability of a random action", [epsilon], min=0))
    return charts


def _episode_chart(title: str, y: str, episodes: pd.DataFrame, column: str, **options: Any) -> Chart:
    initial, others, kinds = by_start(episodes)
    groups = [("initial pose", initial, "raw", "mean"), (kinds, others, "raw2", "mean2")]
    groups = [group for group in groups if len(group[1])]
    drawn = []
    for name, table, light, _ in groups:
        kept = thinned(table)
        drawn.append(series(name, light, kept["episode"], kept[column], "dots"))
    window = smoothing_window(groups[0][1])
    for name, table, _, dark in groups:
        kept = thinned(table)
        mean = moving_average(table[column], window)[kept.index]
        drawn.append(series(f"{name}, mean of {window}", dark, kept["episode"], mean))
    return chart(title, "Episode", y, drawn, **options)


def _outcome_chart(episodes: pd.DataFrame, window: int) -> Chart:
    kept = thinned(episodes, 1_000)
    shares = [
        series(
            name,
            name,
            kept["episode"],
            moving_average((episodes["outcome"] == name).astype(float), window)[kept.index],
            "stack",
        )
        for name in palette.OUTCOMES
    ]
    return chart(
        "Outcomes", "Episode", f"Share of the last {window} episodes", shares, percent=True, min=0, max=1
    )


def evaluation_chart(evaluations: pd.DataFrame) -> Chart:
    """Return a chart of the share of greedy episodes that dock in each evaluation; stars mark the best."""
    names = {"pose": ("evaluation poses", "mean2"), "validation": ("validation starts", "mean")}
    lines = []
    for kind, table in evaluations.groupby("start_kind", sort=False):
        share = (table["outcome"] == "docked").groupby(table["env_steps"]).mean()
        name, tone = names.get(str(kind), (str(kind), "s3"))
        best = sorted(table.loc[table["best"] == 1, "env_steps"].unique())
        lines.append(series(name, tone, share.index, share, marks=numbers(best)))
    title = "Greedy evaluations"
    return chart(
        title, "Environment steps  (★ best so far)", "Share docked", lines, percent=True, min=0, max=1
    )


def update_charts(updates: pd.DataFrame) -> list[Chart]:
    """Return one chart for each recorded metric of the updates, keys of `UPDATE_COLUMNS`."""
    window, kept, charts = smoothing_window(updates), thinned(updates, 2_000), []
    for column in update_columns(updates):
        values = updates[column]
        lines = [
            series(column, "raw", kept["env_steps"], kept[column]),
            series(
                f"mean of {window} rows",
                "mean",
                kept["env_steps"],
                moving_average(values, window)[kept.index],
            ),
        ]
        is_log = column != "q_mean" and bool((values.dropna() > 0).all())
        charts.append(
            chart(UPDATE_COLUMNS[column], "Environment steps", UPDATE_COLUMNS[column], lines, log=is_log)
        )
    return charts


def track_tones(tracks: Sequence[Track]) -> list[str]:
    """Return the color of each track in the style sheet."""
    return [TRACK_TONES[i % len(TRACK_TONES)] for i in range(len(tracks))] if len(tracks) > 1 else ["mean"]


def docking_charts(tracks: Sequence[Track], task: Task) -> list[Chart]:
    """Return charts of distance, heading error, velocities and commands over time, with tolerance bands."""
    shown = (
        ("Distance to the goal", "distance_m", "δd [m]", "line"),
        ("Heading error", "heading_error_deg", "δψ [°]", "line"),
        ("Surge", "u_mps", "u [m/s]", "line"),
        ("Sway", "v_mps", "v [m/s]", "line"),
        ("Yaw rate", "r_degps", "r [°/s]", "line"),
        ("Propeller force", "propeller_n", "P [N]", "step"),
        ("Rudder angle", "rudder_deg", "φ [°]", "step"),
    )
    tones = track_tones(tracks)
    charts = []
    for title, column, y, kind in shown:
        to_goal = column in ("distance_m", "heading_error_deg")
        lines = [
            series(
                track.label, tone, track.table["time_s"], track.table[column], kind,
                breaks=_breaks(track, column) if to_goal else [],
            )
            for track, tone in zip(tracks, tones, strict=True)
        ]  # fmt: skip
        if kind == "step" and max(len(track.table) for track in tracks) > DENSE_STEPS:
            lines += [
                series(
                    f"{track.label}, mean of {MEAN_STEPS}",
                    tone,
                    track.table["time_s"],
                    _mean(track.table[column]),
                )
                for track, tone in zip(tracks, tones, strict=True)
            ]
        options: Chart = {"bands": _bands(tracks, task, column), "group": "time"}
        charts.append(chart(title, "Time [s]", y, lines, **options))
    return charts


def _mean(commands: pd.Series) -> pd.Series:
    """Return the mean of the commands around each step."""
    return commands.rolling(MEAN_STEPS, center=True, min_periods=1).mean()


def _breaks(track: Track, column: str) -> list[int]:
    """Return the rows before which a line would connect two goals, or cross ±180°."""
    rows = {track.switch} - {None}
    if column == "heading_error_deg":
        rows |= set((np.flatnonzero(np.abs(np.diff(track.table[column])) > 180) + 1).tolist())
    return sorted(row for row in rows if row is not None)


def _bands(tracks: Sequence[Track], task: Task, column: str) -> list[Chart]:
    """Return the tolerances of the goals as bands over the times when they apply, in the column's unit."""

    def band(start: float | None, end: float | None, tolerance: Tolerance) -> Chart:
        if column == "distance_m":
            return {"x0": start, "x1": end, "y0": 0, "y1": tolerance.distance_m}
        width = float(np.degrees(tolerance.heading))
        return {"x0": start, "x1": end, "y0": -width, "y1": width}

    if column not in ("distance_m", "heading_error_deg"):
        return []
    return [band(*span) for span in plan_view.tolerance_spans(tracks, task)]


def path_chart(title: str, scene: Scene, tracks: Sequence[Track], task: Task) -> tuple[Chart, Chart]:
    """Return the chart of the trajectories over the harbor, and the harbor that it shows."""
    points = np.concatenate(
        [*(t.table[["x_m", "y_m"]].to_numpy(float) for t in tracks), plan_view.task_points(task)]
    )
    plan = plan_view.extended(scene, points)
    view = plan_view.close_view(plan, points, aspect=(0.9, 1.5))
    tones = track_tones(tracks)
    interval = plan_view.outline_interval(tracks)
    drawn = [
        {
            "name": track.label,
            "tone": tone,
            "outcome": str(track.table["outcome"].iloc[-1]),
            **{key: numbers(thinned(track.table)[column]) for key, column in TRACK_COLUMNS.items()},
        }
        for track, tone in zip(tracks, tones, strict=True)
    ]
    made: Chart = {
        "type": "plan",
        "title": title,
        "view": numbers(view),
        "tracks": drawn,
        "interval_s": interval,
    }
    return made | {"goals": _goals(task), "hull": _flat(plan.hull), "group": "time"}, harbor_shapes(
        plan, view
    )


TRACK_COLUMNS = {
    "time": "time_s", "x": "x_m", "y": "y_m", "heading": "heading_deg", "u": "u_mps",
    "propeller": "propeller_n", "rudder": "rudder_deg", "distance": "distance_m",
}  # fmt: skip
"""Keys of a track in the page, and their columns."""


def map_chart(table: pd.DataFrame, scene: Scene, task: Task) -> tuple[Chart, Chart]:
    """Return the success map, one panel per heading offset, and the harbor behind it.

    Args:
        table: columns `dockctl.analysis.success_map.COLUMNS`.
    """
    side = spacing(table)
    goals = [p for p in (task.final, task.intermediate) if p is not None]
    points = np.concatenate([table[["x_m", "y_m"]].to_numpy(float), [[p.x_m, p.y_m] for p in goals]])
    low, high = points.min(axis=0) - side / 2 - 0.6, points.max(axis=0) + side / 2 + 0.6
    view = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    panels = []
    for heading, part in table.groupby("dheading_deg"):
        free = part[part["blocked"] == 0]
        docked = int((free["outcome"] == "docked").sum())
        offset = "heading of the pose" if heading == 0 else f"{float(str(heading)):+g}°".replace("-", "−")
        outcomes = part["outcome"].where(part["blocked"] == 0, "blocked").fillna("blocked")
        cells: Chart = {name: numbers(part[f"{name}_m"]) for name in ("x", "y")}
        cells |= {"heading": numbers(part["heading_deg"]), "outcome": [str(o) for o in outcomes]}
        if "time_s" in part:
            cells["time"] = numbers(part["time_s"])
        panels.append({"title": f"{offset}: {docked} of {len(free)}", "cells": cells})
    made: Chart = {"type": "map", "title": "Success by start pose", "view": numbers(view), "side": side}
    return made | {"panels": panels, "goals": _goals(task), "hull": _flat(scene.hull)}, harbor_shapes(
        scene, view
    )


def harbor_shapes(scene: Scene, view: Bounds) -> Chart:
    """Return the shapes of the harbor within a view: fill, edge, and x, y of the corners [cm]."""
    x0, y0, x1, y1 = view
    drawn = [s for s in strokes(scene) if _is_inside(s, view)]
    shapes: list[list[Any]] = []
    for stroke in drawn:
        corners = np.round(100 * stroke.xy).astype(int).ravel().tolist()
        shapes.append([stroke.fill, stroke.edge, corners])
    return {"shapes": shapes, "view": numbers((x0, y0, x1, y1))}


def _is_inside(stroke: Stroke, view: Bounds) -> bool:
    low, high = stroke.xy.min(axis=0), stroke.xy.max(axis=0)
    return bool((high >= view[:2]).all() and (low <= view[2:]).all())


def latency_charts(samples: pd.DataFrame, control_period_ms: float) -> list[Chart]:
    """Return a histogram of each part of a decision.

    Args:
        samples: one row per decision, columns `dockctl.analysis.latency.PARTS` [ms].
    """
    charts = []
    for part in timed_parts(samples):
        values = samples[part].to_numpy(float)
        low, high = max(float(values.min()), 1e-4), float(values.max())
        edges = np.geomspace(low * 0.98, high * 1.02, BINS)
        counts, _ = np.histogram(values, edges)
        bars = series("decisions", "mean", edges[:-1], counts, "bars", until=numbers(edges[1:]))
        lines = [{"x": control_period_ms, "label": "control period"}] if part == "decision_ms" else []
        charts.append(chart(PARTS[part], "Time [ms]", "Decisions", [bars], logx=True, min=0, lines=lines))
    return charts


def interval_chart(title: str, x: str, rows: Sequence[Mapping[str, Any]], **options: Any) -> Chart:
    """Return a chart of values with their confidence intervals, one line per row.

    Args:
        rows: ``label``, ``value``, ``low``, ``high``, ``text`` for the tooltip, and optional ``dots``.
    """
    return {"type": "intervals", "title": title, "x": {"label": x}, "rows": [*rows], **options}


def _goals(task: Task) -> list[list[float]]:
    """Return x, y [m], heading [rad] and the radius of the tolerance [m] of each goal."""
    goals = [(task.final, task.final_tolerance)]
    if task.intermediate is not None:
        goals.append((task.intermediate, task.intermediate_tolerance))
    return [[*pose_array(pose).tolist(), tolerance.distance_m] for pose, tolerance in goals]


def _flat(points: Floats) -> list[float]:
    return [float(value) for value in np.round(points, 3).ravel()]
