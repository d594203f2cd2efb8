"""Time series of recorded trajectories (thesis Figs. 4.5-4.10, 4.15-4.20, 4.25-4.30)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from dockctl.drawing import palette
from dockctl.reports.plan_view import Track, tolerance_spans
from dockctl.reports.style import label, legend_above
from dockctl.scenarios.schema import Task

LEAST_STEP_PT = 1.5
"""Below this width of a control period, commands would merge into a block: drawn thin, with their mean."""
MEAN_STEPS = 20


def draw_distance(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Draw the distance to the goal of the current phase (Fig. 4.5)."""
    _draw_lines(ax, tracks, "distance_m", gap_at_switch=True)
    ax.set(ylabel="Distance δd [m]", ylim=(0, None))
    for start, end, tolerance in tolerance_spans(tracks, task):
        width = tolerance.distance_m
        _draw_tolerance(ax, (start, end), (0.0, width), f"tolerance {width:g} m")


def draw_heading_error(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Draw the heading error to the goal of the current phase, within ±180° (Fig. 4.6)."""
    _draw_lines(ax, tracks, "heading_error_deg", gap_at_switch=True)
    ax.set_ylabel("Heading error δψ [°]")
    for start, end, tolerance in tolerance_spans(tracks, task):
        width = math.degrees(tolerance.heading)
        _draw_tolerance(ax, (start, end), (-width, width), f"tolerance ±{width:.2g}°")


def draw_velocity(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Draw surge as solid and sway as dotted lines (Fig. 4.7)."""
    _draw_lines(ax, tracks, "u_mps")
    _draw_lines(ax, tracks, "v_mps", mark_end=False, linestyle=":")
    ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
    if len(tracks) > 1:
        ax.set_ylabel("u (solid), v (dotted) [m/s]")
    else:
        ax.set_ylabel("Velocity [m/s]")
        legend_above(ax, [("surge u", tracks[0].color), ("sway v", tracks[0].color, ":")])


def draw_yaw_rate(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Draw the yaw rate (Fig. 4.8)."""
    _draw_lines(ax, tracks, "r_degps")
    ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
    ax.set_ylabel("Yaw rate r [°/s]")


def draw_propeller(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Draw the propeller force of each control period (Fig. 4.9)."""
    _draw_commands(ax, tracks, "propeller_n")
    ax.set_ylabel("Propeller force P [N]")


def draw_rudder(ax: Axes, tracks: Sequence[Track], task: Task) -> None:
    """Draw the rudder angle of each control period (Fig. 4.10)."""
    _draw_commands(ax, tracks, "rudder_deg")
    ax.set_ylabel("Rudder angle φ [°]")


def mark_phases(ax: Axes, tracks: Sequence[Track], *, names: bool = True) -> None:
    """Shade the first phase of a single two-phase track, and label both phases."""
    if len(tracks) > 1 or (row := tracks[0].switch) is None:
        return
    time_s = float(tracks[0].table["time_s"].iloc[row])
    ax.axvspan(0, time_s, color=palette.WATER, alpha=0.45, lw=0, zorder=0)
    ax.axvline(time_s, color=palette.WATER_DEEP, lw=1.0, zorder=1)
    if not names:
        return
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.07 * (high - low))  # space for the labels
    for text, shift, side in (("to the intermediate pose", -5, "right"), ("to the berth", 5, "left")):
        above = {"xycoords": ax.get_xaxis_transform(), "va": "top", "color": palette.INK_SOFT}
        label(ax, text, (time_s, 1.0), (shift, -4), ha=side, **above)


def with_gaps(time: np.ndarray, values: np.ndarray, rows: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Insert NaN before each of `rows`, where a line would connect two goals or cross ±180°.

    Args:
        time, values: (k,).

    Returns:
        Both with NaN inserted, (k + len(rows),).
    """
    return np.insert(time, rows, np.nan), np.insert(values, rows, np.nan)


def _draw_lines(
    ax: Axes,
    tracks: Sequence[Track],
    column: str,
    *,
    gap_at_switch: bool = False,
    mark_end: bool = True,
    linestyle: object = "-",
) -> None:
    for track in tracks:
        time, values = track.table["time_s"].to_numpy(float), track.table[column].to_numpy(float)
        gaps = {track.switch} if gap_at_switch and track.switch is not None else set()
        if column == "heading_error_deg":
            gaps |= set((np.flatnonzero(np.abs(np.diff(values)) > 180) + 1).tolist())
        ax.plot(
            *with_gaps(time, values, sorted(gaps)),
            color=track.color,
            linestyle=linestyle,
            label=f"{track.label} {column}",
        )
        if mark_end:
            ax.plot(
                time[-1], values[-1], "o", ms=4.5, color=track.color, mec="white", mew=0.8, clip_on=False,
                zorder=5,
            )  # fmt: skip
    _finish_axes(ax, tracks)


def _draw_commands(ax: Axes, tracks: Sequence[Track], column: str) -> None:
    is_dense = _step_width_pt(ax, tracks) < LEAST_STEP_PT
    for track in tracks:
        time, values = track.table["time_s"], track.table[column]
        # The command of a row was applied over the control period that ends at its time.
        ax.step(
            time, values, where="pre", color=track.color, lw=0.4 if is_dense else 1.3,
            alpha=0.4 if is_dense else 1.0, label=f"{track.label} {column}",
        )  # fmt: skip
        if is_dense:
            mean = values.rolling(MEAN_STEPS, center=True, min_periods=1).mean()
            ax.plot(time, mean, color=track.color, lw=1.6, label=f"{track.label} {column}, mean")
    if is_dense:
        label(
            ax, f"thick: mean over {MEAN_STEPS} steps", (1.0, 1.0), (-4, -4), xycoords="axes fraction",
            ha="right", va="top", fontsize=7.5, color=palette.INK_SOFT,
        )  # fmt: skip
    ax.axhline(0, color=palette.RULE, lw=0.8, zorder=1)
    _finish_axes(ax, tracks)


def _step_width_pt(ax: Axes, tracks: Sequence[Track]) -> float:
    """Return the approximate width of a control period on the page [pt], before the final layout."""
    period_s = min(
        float(np.diff(track.table["time_s"].astype(float)).min(initial=np.inf)) for track in tracks
    )
    width_pt = float(ax.get_window_extent().width) * 72 / ax.figure.dpi
    return width_pt * period_s / _end_s(ax, tracks)


def _end_s(ax: Axes, tracks: Sequence[Track]) -> float:
    """Return the end of the time axis [s]; a wider limit that was set for shared axes is kept."""
    longest = 1.015 * max(float(track.table["time_s"].iloc[-1]) for track in tracks)
    return max(longest, ax.get_xlim()[1])


def _finish_axes(ax: Axes, tracks: Sequence[Track]) -> None:
    ax.set(xlim=(0, _end_s(ax, tracks)), xlabel="Time [s]")
    legend_above(ax, [(track.label, track.color) for track in tracks])


def _draw_tolerance(
    ax: Axes, span: tuple[float | None, float | None], band: tuple[float, float], text: str
) -> None:
    begin, end = span
    times = (0.0 if begin is None else begin, ax.get_xlim()[1] if end is None else end)
    ax.fill_between(times, *band, color=palette.DOCKED, alpha=0.18, lw=0, zorder=0.5)
    # The label of the last band is at its end, where the boats are inside the band.
    is_last = times[1] >= ax.get_xlim()[1]
    x, shift, side = (times[1], -4, "right") if is_last else (times[0], 4, "left")
    label(ax, text, (x, band[1]), (shift, 3), ha=side, color=palette.DOCKED, zorder=6)
