"""The figures of docs/performance.md, from the results of the benchmarks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from dockctl.drawing import palette
from dockctl.reports.plan_view import Track, close_view, draw_harbor, draw_paths
from dockctl.reports.style import legend_above, make_axes, make_figure
from dockctl.scenarios.loader import load
from dockctl.sim.harbor.build import build_harbor, build_scene

OURS, PEER = palette.SINGLE, palette.SECOND_MEAN
Json = dict[str, Any]


def number(value: float) -> str:
    """Format a number with three significant digits."""
    if value == 0:
        return "0"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def median_and_errors(seconds: Json, factor: float) -> tuple[float, list[list[float]]]:
    """Return the median and the error bars of a summary over the rounds, for matplotlib."""
    middle = factor * seconds["median"]
    return middle, [[middle - factor * seconds["min"]], [factor * seconds["max"] - middle]]


def curve(ax: Axes, x: Sequence[float], points: Sequence[Json], factor: float, color: str) -> None:
    """Draw medians over the rounds, with error bars from minimum to maximum."""
    for at, seconds in zip(x, points, strict=True):
        middle, spread = median_and_errors(seconds, factor)
        ax.errorbar([at], [middle], yerr=spread, color=color, capsize=2.5, lw=1.2)
    ax.plot(x, [factor * seconds["median"] for seconds in points], color=color, marker="o", ms=4)


def logarithmic(ax: Axes, x: Sequence[float], x_label: str, y_label: str) -> None:
    """Make both axes logarithmic, with the measured sizes as ticks of the lower one."""
    ax.set(xscale="log", yscale="log", xlabel=x_label, ylabel=y_label)
    ax.set_xticks(x, [short(value) for value in x])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.margins(x=0.06, y=0.12)


def short(value: float) -> str:
    """Format a size for an axis: 32, 8,192, 14k, 907k, 1.2M."""
    if value >= 1e6:
        return f"{value / 1e6:.1f}M"
    return f"{value:,.0f}" if value < 1e4 else f"{value / 1e3:.0f}k"


def growth_figure(growth: Json) -> Figure:
    """Return the figure of times over rays and triangles, compared with embree."""
    subtitle = "one core; error bars from the minimum to the maximum of the rounds"
    figure = make_figure("Scaling", subtitle, (8.4, 4.0))
    panels = (("rays", "rays per scan"), ("triangles", "triangles in the harbor"))
    for ax, (size, x_label) in zip(figure.subplots(1, 2), panels, strict=True):
        points = growth["facts"][size]
        x = [point[size] for point in points]
        curve(ax, x, [point["peer"] for point in points], 1e3, PEER)
        curve(ax, x, [point["dockctl"] for point in points], 1e3, OURS)
        logarithmic(ax, x, x_label, "time of a scan [ms]")
        legend_above(ax, [("dockctl", OURS), ("trimesh + embree + numpy", PEER)])
    return figure


def boats_figure(environment: Json) -> Figure:
    """Return the figure of the time per step and the memory over the number of boats."""
    facts = environment["facts"]
    subtitle = f"environment of scenario 3, all rays, {facts['cores']} cores"
    figure = make_figure("Time and memory per boat", subtitle)
    left, right = figure.subplots(1, 2)
    curve(left, facts["boats"], facts["processor_seconds"], 1e6, OURS)
    logarithmic(left, facts["boats"], "boats", "CPU time per boat and step [µs]")
    left.set(yscale="linear", ylim=(0, None))
    held = [value / 1e6 for value in facts["held_bytes"]]
    line = [(facts["held_bytes"][0] + facts["held_bytes_a_boat"] * boats) / 1e6 for boats in facts["boats"]]
    right.plot(facts["boats"], line, color=palette.RULE, ls="--")
    right.plot(facts["boats"], held, "o", color=OURS, ms=5)
    logarithmic(right, facts["boats"], "boats", "memory without harbor and tables [MB]")
    per_boat = number(facts["held_bytes_a_boat"] / 1e3)
    legend_above(right, [("measured", OURS), (f"{per_boat} kB per boat", palette.RULE, "--")])
    left.set_title(" ", fontsize=8.5, pad=7)
    return figure


def scan_figure(lidar: Json) -> Figure:
    """Return the figure of the time of a scan on one core with each library, on a logarithmic scale."""
    facts = lidar["facts"]
    subtitle = f"{facts['rays']:,} rays, {facts['triangles']:,} triangles; one core, median of the rounds"
    figure = make_figure("Time of a scan of the marina", subtitle, (7.6, 2.7))
    ax = figure.add_subplot()
    times = [(name, 1e3 * s["median"]) for name, s in lidar["seconds"].items() if "wall clock" not in name]
    times.sort(key=lambda time: -time[1])
    for row, (name, milliseconds) in enumerate(times):
        color = OURS if name.startswith("dockctl") else PEER
        ax.plot([milliseconds], [row], "o", ms=9, color=color)
        ax.annotate(
            f"{number(milliseconds)} ms",
            (milliseconds, row),
            (10, 0),
            textcoords="offset points",
            va="center",
        )
    ax.set(xscale="log", xlabel="milliseconds per scan", yticks=range(len(times)))
    ax.set_yticklabels([name for name, _ in times], color=palette.INK)
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_xlim(0.5 * times[-1][1], 3 * times[0][1])
    ax.set_ylim(len(times) - 0.5, -0.5)
    return figure


def docking_figure(optimal: Json) -> Figure:
    """Return the plan view of the optimal paths of scenario 3 and s3-direct, and of their policies."""
    loaded = load("s3")
    names = {
        "s3-direct": ("direct, optimal", palette.PURPLE),
        "s3": ("optimal", palette.BLUE),
        "s3-direct, policy": ("direct, policy", palette.GREEN),
        "s3, policy": ("policy", PEER),
    }
    tracks = []
    for path, (name, color) in names.items():
        table = pd.DataFrame(optimal["facts"]["paths"][path])
        tracks.append(Track(f"{name}: {table['time_s'].iloc[-1]:.1f} s", color, table))
    scenario = loaded.scenario
    scene = build_scene(build_harbor(scenario.harbor, loaded.base_dir), scenario.vessel.hull)
    points = np.concatenate([track.table[["x_m", "y_m"]].to_numpy(float) for track in tracks])
    figure, ax = make_axes("Scenario 3 in minimum time", "outlines at equal intervals of time", (7.6, 7.2))
    draw_harbor(ax, scene, close_view(scene, points))
    draw_paths(ax, scene, tracks, scenario.task)
    return figure
