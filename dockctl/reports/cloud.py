"""What the LiDARs see: points in three dimensions, and from above in their sectors (Figs. 3.6, 3.9)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, PowerNorm
from matplotlib.patches import Circle, Polygon, Wedge
from numpy.typing import NDArray

from dockctl.drawing import palette
from dockctl.drawing.plan import water
from dockctl.drawing.scene import Scene
from dockctl.geometry import sector_index
from dockctl.reports.style import HALO
from dockctl.reports.view3d import Camera, draw_water

Floats = NDArray[np.float64]

HEIGHTS = LinearSegmentedColormap.from_list(
    "heights", ["#3E9FD6", "#6FD3C4", "#D7E58A", "#F8C152", "#F2705B"]
)
"""From the water to the mastheads; each tone stands out on the dark water."""
LARGEST_VIEW_M = 30.0
RING_STEPS_M = (1.0, 2.0, 5.0, 10.0, 20.0)


def draw_cloud(ax: Axes, camera: Camera, points: Floats, highest_m: float) -> PathCollection:
    """Draw (k, 3) points in the world frame, colored by height from 0 to `highest_m`, the nearest on top."""
    flat, depth = camera.project(points)
    order = np.argsort(-depth, kind="stable")
    return ax.scatter(
        flat[order, 0],
        flat[order, 1],
        c=points[order, 2],
        cmap=HEIGHTS,
        norm=PowerNorm(0.6, 0.0, highest_m),
        s=np.clip(150.0 / depth[order], 0.8, 7.0),
        lw=0,
        rasterized=True,
        zorder=3,
    )


def draw_ground(ax: Axes, camera: Camera, scene: Scene, centre: Floats, radii_m: Sequence[float]) -> None:
    """Draw the harbor's plan in dark tones at z = 0, and circles around the boat, each with its radius."""
    plan = [polygon.xy for polygon in scene.polygons if polygon.kind in ("quay", "finger", "hull", "mesh")]
    on_water = [camera.project(np.insert(xy, 2, 0.0, axis=1))[0] for xy in plan]
    draw_water(ax, camera, water(scene), palette.NIGHT_WATER)
    ax.add_collection(
        PolyCollection(on_water, fc=palette.NIGHT_LAND, ec=palette.NIGHT_RULE, lw=0.3, zorder=1.2)
    )
    turn = np.linspace(0, 2 * np.pi, 181)
    for radius in radii_m:
        circle = np.stack(
            [centre[0] + radius * np.cos(turn), centre[1] + radius * np.sin(turn), 0 * turn], axis=1
        )
        ring, _ = camera.project(circle)
        ax.plot(*ring.T, color=palette.WATER_DEEP, lw=0.7, ls=(0, (4, 3)), zorder=1.4)
        x, y = ring[np.argmin(ring[:, 1])]
        ax.text(
            x,
            y,
            f"{radius:g} m",
            ha="center",
            va="bottom",
            fontsize=7.5,
            color=palette.WATER,
        )


def draw_sectors(ax: Axes, points: Floats, ranges_m: Floats, hull: Floats, range_m: float) -> None:
    """Draw the points from above with the bow up, the sectors, and the nearest point of each.

    Args:
        points: (k, 3) returns in the body frame [m].
        ranges_m: (n,) nearest return of each sector, `range_m` where there is none.
        hull: (j, 2) outline of the boat in the body frame [m].
        range_m: the LiDAR's range.
    """
    count = len(ranges_m)
    rho = np.hypot(points[:, 0], points[:, 1])
    view = view_radius(ranges_m, range_m)
    edges = np.linspace(-180.0, 180.0, count + 1)
    for i in range(count):
        tint = palette.WATER if i % 2 else "#EAF3F7"
        ax.add_patch(
            Wedge((0, 0), 2 * view, edges[i] + 90, edges[i + 1] + 90, fc=tint, ec="white", lw=1.0, zorder=0)
        )
    step = next((step for step in RING_STEPS_M if view / step <= 5), RING_STEPS_M[-1])
    for radius in np.arange(step, view, step):
        ax.add_patch(Circle((0, 0), radius, fc="none", ec=palette.WATER_SHADE, lw=0.6, zorder=1))
    ax.plot(
        *on_page(points), ".", ms=1.6, mew=0, color=palette.INK_SOFT, alpha=0.55, rasterized=True, zorder=2
    )
    sector = np.array([sector_index(x, y, count) for x, y, _ in points.tolist()])
    for i, nearest in enumerate(ranges_m):
        middle = np.radians((edges[i] + edges[i + 1]) / 2)
        inside = np.flatnonzero(sector == i)
        if nearest >= range_m or not len(inside):
            text, at, radius = f"d{i + 1}  nothing", middle, 0.72 * view
        else:
            point = points[inside[np.argmin(rho[inside])]]
            x, y = on_page(point[None])
            ax.plot([0, x[0]], [0, y[0]], color=palette.GOAL, lw=1.1, zorder=4)
            ax.plot(x, y, "o", ms=5.5, color=palette.GOAL, mec="white", mew=0.9, zorder=5)
            # Names keep off the edges of their sector: two of them often share one nearest corner there.
            near_edge = np.radians(0.2 * (edges[1] - edges[0]))
            at = np.clip(
                np.arctan2(point[1], point[0]),
                np.radians(edges[i]) + near_edge,
                np.radians(edges[i + 1]) - near_edge,
            )
            text = f"d{i + 1}  {nearest:.2f} m"
            radius = min(nearest + 0.09 * view, 0.93 * view)
        (tx,), (ty,) = on_page(radius * np.array([[np.cos(at), np.sin(at)]]))
        at_edge = abs(tx) > 0.7 * view
        outwards = "center" if abs(tx) < 0.3 * view else "left" if (tx > 0) != at_edge else "right"
        ax.text(
            math.copysign(0.97 * view, tx) if at_edge else tx,
            ty,
            text,
            ha=outwards,
            va="center",
            fontsize=8.5,
            fontweight="bold",
            color=palette.INK,
            path_effects=HALO,
            zorder=7,
        )
    ax.add_patch(Polygon(np.transpose(on_page(hull)), fc=palette.OWN_HULL, ec="white", lw=0.8, zorder=6))
    ax.set_aspect("equal")
    ax.set_xlim(-view, view)
    ax.set_ylim(-view, view)
    ticks = [tick for tick in ax.get_xticks() if abs(tick) < view]
    ax.set_xticks(
        ticks, [f"{0 - tick:g}".replace("-", "−") for tick in ticks]
    )  # port is left, and y points to port
    ax.set_yticks(ticks)
    ax.set_xlabel("y in the body frame, to port [m]")
    ax.set_ylabel("x in the body frame, forward [m]")
    ax.grid(False)
    ax.spines[:].set_visible(True)


def on_page(points: Floats) -> tuple[Floats, Floats]:
    """Body-frame x, y of (k, 2 or 3) points to page coordinates with the bow up: port is left."""
    return -points[:, 1], points[:, 0]


def view_radius(ranges_m: Floats, range_m: float) -> float:
    """Half the width of the picture: all the nearest points and their names, at most `LARGEST_VIEW_M`."""
    seen = ranges_m[ranges_m < range_m]
    return float(np.clip(1.35 * seen.max(), 6.0, LARGEST_VIEW_M)) if len(seen) else LARGEST_VIEW_M
