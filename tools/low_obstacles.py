"""Draw what the LiDARs measure of low obstacles alongside: docs/figures/low-obstacles.png.

python -m tools.low_obstacles
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dockctl.drawing import palette
from dockctl.geometry import Floats
from dockctl.reports.style import METADATA, figure_style, label, legend_above, make_figure, panel_title
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.solids import box
from dockctl.sim.lidar.spinning import SpinningLidars
from dockctl.sim.lidar.spinning_sensor import SpinningSensor

FIGURES = Path(__file__).parent.parent / "docs" / "figures"
HULL, LIDARS = Hull(), SpinningLidars()
PORT = 1  # the LiDAR that looks to port
HEIGHTS_M = {"finger pier, 0.5 m": 0.5, "quay, 1 m": 1.0, "wall, 2 m": 2.0}
GAP_M = 0.4  # in the section


def readings(height_m: float, gaps_m: Floats) -> Floats:
    """Return the range (n,) [m] of the sector abeam to port, beside a quay of this height.

    Args:
        gaps_m: (n,) between the hull and the quay [m].
    """
    quay = np.asarray(box((-30.0, 0.0, -1.0), (30.0, 12.0, height_m)).triangles)
    sensor, heading = SpinningSensor(LIDARS, quay), np.zeros(len(gaps_m))
    ranges = sensor.sector_ranges(np.column_stack([heading, -HULL.beam_m / 2 - gaps_m, heading]))
    return ranges[:, [5, 6]].min(axis=1)  # the two sectors that meet at 90°


def steepest_deg() -> float:
    """Return the angle below the horizon of the steepest ray to port [°]."""
    return LIDARS.mounts[PORT].pitch_deg - LIDARS.lowest_channel_deg


def draw() -> Figure:
    """Return the figure."""
    figure = make_figure(
        "Low obstacles alongside are measured at a constant range",
        f"LiDARs of Table 3.2, 3 m above the water; no ray to port is steeper than {steepest_deg():g}°",
        (8.4, 3.9),
    )
    section, curves = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    _section(section)
    _curves(curves)
    return figure


def _section(ax: Axes) -> None:
    """Draw boat, quay and the fan of rays to port, seen from ahead."""
    half, top, mount = HULL.beam_m / 2, 1.0, LIDARS.mounts[PORT]
    edge = half + GAP_M
    angles = np.radians(
        mount.pitch_deg + np.linspace(LIDARS.lowest_channel_deg, LIDARS.highest_channel_deg, 16)
    )
    for angle in angles:
        reach = (mount.z_m - top) / np.tan(angle)
        ax.plot([mount.y_m, mount.y_m + reach], [mount.z_m, top], color=palette.MEAN, lw=0.8, alpha=0.6)
    nearest = mount.y_m + (mount.z_m - top) / np.tan(angles.max())
    ax.axhspan(-0.6, 0, color=palette.WATER, zorder=0)
    fill, rule = palette.SOLIDS["quay"]
    ax.fill([edge, 4, 4, edge], [-0.6, -0.6, top, top], fc=fill, ec=rule)
    ax.fill([-half, half, half, -half], [-HULL.draft_m, -HULL.draft_m, HULL.freeboard_m, HULL.freeboard_m],
            fc=palette.OWN_HULL)  # fmt: skip
    ax.plot([mount.y_m, mount.y_m], [HULL.freeboard_m, mount.z_m], color=palette.INK_SOFT, lw=1.2)
    ax.plot(mount.y_m, mount.z_m, "o", color=palette.INK, ms=5)
    ax.plot(nearest, top, "o", color=palette.GOAL, ms=5, zorder=5)
    ax.annotate("", (0, 1.35), (nearest, 1.35), arrowprops={"arrowstyle": "<->", "color": palette.GOAL})
    label(ax, f"{nearest:.2f} m", (-0.06, 1.35), color=palette.GOAL, ha="right", va="center")
    ax.plot([0, 0], [HULL.freeboard_m, 1.45], color=palette.GOAL, lw=0.8, ls=":")
    label(ax, "quay", (2.6, 0.4))
    ax.set(xlim=(-1.0, 4.0), ylim=(-0.6, 3.3), aspect="equal", xlabel="to port [m]", ylabel="height [m]")
    panel_title(ax, f"{GAP_M:g} m beside a quay of 1 m")


def _curves(ax: Axes) -> None:
    """Draw the range abeam by the gap, for obstacles of several heights."""
    gaps = np.linspace(0, 2, 201)
    ax.plot(gaps, HULL.beam_m / 2 + gaps, color=palette.INK_SOFT, lw=1.0, ls="--")
    entries: list[tuple[str, str] | tuple[str, str, str]] = []
    for (name, height), color in zip(HEIGHTS_M.items(), palette.SERIES, strict=False):
        ax.plot(gaps, readings(height, gaps), color=color)
        entries.append((name, color))
    ax.set(xlim=(0, 2), ylim=(0, 2.6), xlabel="gap between hull and obstacle [m]", ylabel="range abeam [m]")
    legend_above(ax, [*entries, ("side of the obstacle", palette.INK_SOFT, "--")], columns=2)


if __name__ == "__main__":
    with figure_style():
        draw().savefig(FIGURES / "low-obstacles.png", metadata=METADATA["png"])
