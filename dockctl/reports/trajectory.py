"""What the boat did on its way, over time (thesis Figs. 4.5-4.10, 4.15-4.20, 4.25-4.30)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from dockctl.analysis.trajectories import Track
from dockctl.drawing import palette
from dockctl.reports.style import HALO, legend_above
from dockctl.scenarios.schema import Task, Tolerance


def draw_distance(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Distance to the goal of the phase (Fig. 4.5)."""
    _lines(ax, tracks, "distance_m", breaks=True)
    ax.set_ylabel("Distance δd [m]")
    ax.set_ylim(bottom=0)
    for start, end, tolerance in _spans(ax, tracks, task):
        width = tolerance.distance_m
        _tolerance(ax, (start, end), (0.0, width), f"tolerance {width:g} m")


def draw_heading_error(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Heading against the goal's, within ±180° (Fig. 4.6)."""
    _lines(ax, tracks, "heading_error_deg", breaks=True)
    ax.set_ylabel("Heading error δψ [°]")
    for start, end, tolerance in _spans(ax, tracks, task):
        width = math.degrees(tolerance.heading)
        _tolerance(ax, (start, end), (-width, width), f"tolerance ±{width:.2g}°")


def draw_velocity(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Surge as full lines and sway as dotted ones (Fig. 4.7)."""
    _lines(ax, tracks, "u_mps")
    _lines(ax, tracks, "v_mps", linestyle=":", mark=False)
    ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
    if len(tracks) > 1:
        ax.set_ylabel("u (full), v (dotted) [m/s]")
    else:
        ax.set_ylabel("Velocity [m/s]")
        legend_above(ax, [("surge u", tracks[0].color), ("sway v", tracks[0].color, ":")])


def draw_yaw_rate(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Yaw rate (Fig. 4.8)."""
    _lines(ax, tracks, "r_degps")
    ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
    ax.set_ylabel("Yaw rate r [°/s]")


def draw_propeller(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Propeller force, held over each control period (Fig. 4.9)."""
    _steps(ax, tracks, "propeller_n")
    ax.set_ylabel("Propeller force P [N]")


def draw_rudder(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Rudder angle, held over each control period (Fig. 4.10)."""
    _steps(ax, tracks, "rudder_deg")
    ax.set_ylabel("Rudder angle φ [°]")


def broken(time: np.ndarray, values: np.ndarray, at: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Put a gap before each row in `at`, so that no line joins two goals or crosses ±180°."""
    return np.insert(time, at, np.nan), np.insert(values, at, np.nan)


def _lines(
    ax: Axes,
    tracks: Sequence[Track],
    column: str,
    *,
    breaks: bool = False,
    mark: bool = True,
    linestyle: object = "-",
) -> None:
    for track in tracks:
        time, values = track.table["time_s"].to_numpy(float), track.table[column].to_numpy(float)
        gaps = []
        if breaks and track.switch is not None:
            gaps.append(track.switch)
        if column == "heading_error_deg":
            gaps += [
                int(i) + 1 for i in np.flatnonzero(np.abs(np.diff(values)) > 180) if int(i) + 1 not in gaps
            ]
        ax.plot(
            *broken(time, values, sorted(gaps)),
            color=track.color,
            linestyle=linestyle,
            label=f"{track.label} {column}",
        )
        if mark:
            ax.plot(
                time[-1],
                values[-1],
                "o",
                ms=4.5,
                color=track.color,
                mec="white",
                mew=0.8,
                clip_on=False,
                zorder=5,
            )
    _time_axis(ax, tracks)


def _steps(ax: Axes, tracks: Sequence[Track], column: str) -> None:
    for track in tracks:
        # The command of a row was held over the period that ends at its time.
        ax.step(
            track.table["time_s"],
            track.table[column],
            where="pre",
            color=track.color,
            lw=1.3,
            label=f"{track.label} {column}",
        )
    ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
    _time_axis(ax, tracks)


def _time_axis(ax: Axes, tracks: Sequence[Track]) -> None:
    ax.set_xlim(0, 1.015 * max(track.table["time_s"].iloc[-1] for track in tracks))
    ax.set_xlabel("Time [s]")
    legend_above(ax, [(track.label, track.color) for track in tracks])


def mark_phases(ax: Axes, tracks: Sequence[Track], *, names: bool = True) -> None:
    """Shade the way to the intermediate pose of a single track, and name its two phases at the top."""
    if len(tracks) > 1 or (row := tracks[0].switch) is None:
        return
    time_s = float(tracks[0].table["time_s"].iloc[row])
    ax.axvspan(0, time_s, color=palette.WATER, alpha=0.45, lw=0, zorder=0)
    ax.axvline(time_s, color=palette.WATER_DEEP, lw=1.0, zorder=1)
    if not names:
        return
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.07 * (high - low))  # room for the names
    for text, shift, side in (("to the intermediate pose", -5, "right"), ("to the berth", 5, "left")):
        ax.annotate(
            text,
            (time_s, 1.0),
            xycoords=ax.get_xaxis_transform(),
            xytext=(shift, -4),
            textcoords="offset points",
            ha=side,
            va="top",
            fontsize=8,
            color=palette.INK_SOFT,
            path_effects=HALO,
        )


def _spans(ax: Axes, tracks: Sequence[Track], task: Task) -> list[tuple[float, float, Tolerance]]:
    """When which tolerance holds: the final one from the first change of phase on, the other to the last."""
    end = ax.get_xlim()[1]
    changes = [float(t.table["time_s"].iloc[row]) for t in tracks if (row := t.switch) is not None]
    if not changes:
        return [(0.0, end, task.final_tolerance)]
    return [(0.0, max(changes), task.intermediate_tolerance), (min(changes), end, task.final_tolerance)]


def _tolerance(ax: Axes, times: tuple[float, float], band: tuple[float, float], text: str) -> None:
    ax.fill_between(times, *band, color=palette.DOCKED, alpha=0.18, lw=0, zorder=0.5)
    # The last band's name stands at its end, where the boats are inside of it.
    is_last = times[1] >= ax.get_xlim()[1]
    ax.annotate(
        text,
        (times[1] if is_last else times[0], band[1]),
        xytext=(-4 if is_last else 4, 3),
        textcoords="offset points",
        ha="right" if is_last else "left",
        fontsize=8,
        color=palette.DOCKED,
        path_effects=HALO,
        zorder=6,
    )
