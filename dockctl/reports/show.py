"""Drawings of a scenario (``dockctl show``): plan view, marina in 3-D, point cloud, LiDAR sectors."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, PowerNorm
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle, Wedge

from dockctl.drawing import palette
from dockctl.drawing.scene import Scene, water
from dockctl.geometry import Floats, pose_label, sector_edges_deg, sector_index, to_world
from dockctl.reports import plan_view, view3d
from dockctl.reports.style import HALO, legend_above, make_axes, make_figure
from dockctl.reports.view3d import Body, Camera
from dockctl.scenarios.schema import Scenario

QUAY_STRIP_M = 5.0
"""Width of the quays in the 3-D view."""
HEIGHT_SHARES = (0.5, 0.6)
TURNS_DEG = (0.0, -4.0, 4.0, -8.0, 8.0, -12.0, 12.0)
"""Cameras tried for the 3-D view, in order of preference: height per length of the marina, and direction."""
CLOUD_EYE_M = np.array([-46.0, -30.0, 30.0])
"""Camera of the point cloud, relative to the boat."""
CLOUD_EXTENT_M = np.array([[-24, -24, 0], [24, -24, 0], [-24, 24, 0], [24, 24, 0], [0, 20, 12]])
"""Points around the boat that the view of the point cloud must contain."""
CLOUD_RINGS_M = (10.0, 20.0, 30.0)
HEIGHTS = LinearSegmentedColormap.from_list(
    "heights", ["#3E9FD6", "#6FD3C4", "#D7E58A", "#F8C152", "#F2705B"]
)
"""Colors of the point cloud from the water to the mastheads; all contrast with the dark water."""
MAX_LAYOUTS = 12
"""Maximum number of generated layouts that are drawn."""
LARGEST_VIEW_M = 30.0
BERTHS = {"trained": ("trained berths", palette.DOCKED), "held_out": ("held-out berths", palette.PURPLE)}
"""Name and color of the berths of a task, by kind."""
SECTOR_RINGS_M = (1.0, 2.0, 5.0, 10.0, 20.0)


@dataclass(frozen=True, eq=False)
class Scan:
    """One LiDAR scan.

    Attributes:
        pose: (3,) of the boat [m, m, rad].
        points: (k, 3) returns in the body frame [m].
        ranges_m: (n,) nearest return of each sector, `range_m` if there is none.
        range_m: maximum range of the sensor.
    """

    pose: Floats
    points: Floats
    ranges_m: Floats
    range_m: float

    @property
    def label(self) -> str:
        return pose_label(self.pose[0], self.pose[1], math.degrees(self.pose[2]))


def figures(
    plan: Scene,
    scenario: Scenario,
    bodies: Sequence[Body],
    hull: Body,
    scan: Scan,
    berths: Mapping[str, Floats],
) -> dict[str, Figure]:
    """Return the four drawings by file name.

    Args:
        plan: plan view of the harbor and the boat.
        bodies: solids of the harbor in the world frame.
        hull: the docking boat in the body frame.
        scan: one scan.
        berths: final poses (k, 3) at the berths of the task, by kind, keys of `BERTHS`.
    """
    plan = plan_view.extended(plan, plan_view.task_points(scenario.task, scenario.evaluation.poses))
    boat = replace(hull, triangles=to_world(hull.triangles, scan.pose))
    return {
        "harbor": harbor_figure(plan, scenario, berths),
        "marina-3d": marina_figure(plan, scenario, [*bodies, boat]),
        "point-cloud": cloud_figure(plan, scenario, boat, scan),
        "sectors": sectors_figure(plan, scenario, scan),
    }


def harbor_figure(plan: Scene, scenario: Scenario, berths: Mapping[str, Floats]) -> Figure:
    """Draw the whole harbor with the berths of the task, and a close-up of its poses (Figs. 3.13-3.15).

    Args:
        berths: see `figures`.
    """
    task, tests = scenario.task, scenario.evaluation.poses
    whole = plan_view.whole_view(plan)
    close = plan_view.close_view(plan, plan_view.task_points(task, tests), aspect=(1.0, 1.0))
    shape = (whole[2] - whole[0]) / (whole[3] - whole[1])
    height = 8.2
    width_of_whole = float(np.clip((height - 1.2) * shape + 0.7, 2.6, 9.0))
    figure = make_figure(
        f"Harbor and poses of scenario {scenario.name}", _list_poses(scenario), (width_of_whole + 7.4, height)
    )
    left, right = figure.subplots(1, 2, width_ratios=(width_of_whole, 7.2))
    plan_view.draw_harbor(left, plan, whole)
    x, y, width, depth = close[0], close[1], close[2] - close[0], close[3] - close[1]
    left.add_patch(Rectangle((x, y), width, depth, fc="none", ec=palette.INK, lw=1.1, zorder=7))
    plan_view.draw_harbor(right, plan, close)
    for ax, named in ((left, False), (right, True)):
        plan_view.draw_poses(ax, plan, task, tests, named=named)
    for kind, poses in berths.items():
        name, color = BERTHS[kind]
        left.plot(*poses[:, :2].T, "o", ms=6.5, color=color, mec="white", mew=0.9, zorder=8, label=name)
    legend_above(left, [BERTHS[kind] for kind in berths], columns=1)
    plan_view.draw_compass(right, close)
    return figure


def layouts_figures(
    scenario: Scenario, drawn: Sequence[tuple[Scene, Floats]], count: int
) -> dict[str, Figure]:
    """Draw the first of `count` layouts, each with a boat at the poses (k, 3) of its free berths."""
    if not drawn:
        return {}
    columns = min(4, len(drawn))
    rows = -(-len(drawn) // columns)
    figure = make_figure(
        f"{len(drawn)} of the {count} layouts of scenario {scenario.name}",
        "the docking boat, red, in each of the free berths",
        (3.6 * columns, 3.7 * rows + 0.8),
    )
    every = list(figure.subplots(rows, columns, squeeze=False).flat)
    for ax, (plan, free) in zip(every, drawn, strict=False):
        view = plan_view.whole_view(plan)
        plan_view.draw_harbor(ax, plan, view)
        for pose in free:
            plan_view.draw_boat(ax, plan.hull, pose, palette.OWN_HULL, fill=0.8)
        width, height = view[2] - view[0], view[3] - view[1]
        ax.set_title(f"{plan.name}, {width:.0f} m × {height:.0f} m", fontsize=9)
        ax.set(xticks=[], yticks=[], xlabel="", ylabel="")
    for ax in every[len(drawn) :]:
        ax.set_visible(False)
    return {"layouts": figure}


def marina_figure(plan: Scene, scenario: Scenario, bodies: Sequence[Body]) -> Figure:
    """Draw the marina in 3-D, with the docking boat in red."""
    bounds = water(plan)
    x0, y0, x1, y1 = bounds
    edge = np.array(
        [[x0 - QUAY_STRIP_M, y0 - QUAY_STRIP_M, -np.inf], [x1 + QUAY_STRIP_M, y1 + QUAY_STRIP_M, np.inf]]
    )
    trimmed = [replace(body, triangles=np.clip(body.triangles, *edge)) for body in bodies]
    cameras = [view3d.overview_camera(bounds, turn, height) for height in HEIGHT_SHARES for turn in TURNS_DEG]
    boat = [body.triangles for body in trimmed if body.kind == "own"]
    others = [body.triangles for body in trimmed if body.kind != "own"]
    camera = view3d.least_occluded(cameras, np.concatenate(boat), np.concatenate(others))
    corners = np.array([[x, y, 0.0] for x in edge[:, 0] for y in edge[:, 1]])
    tops = np.concatenate([body.triangles.reshape(-1, 3) for body in trimmed])
    extent = view3d.extent(camera, np.concatenate([corners, tops[tops[:, 2] > 0]]))
    width, height = extent[1] - extent[0]
    figure, ax = make_axes(
        f"The harbor '{plan.name}'",
        f"scenario {scenario.name}; the docking boat is red",
        (10.4, 10.0 * height / width + 0.9),
    )
    view3d.draw_water(ax, camera, (*edge[0, :2], *edge[1, :2]))  # also in an entrance
    view3d.draw_bodies(ax, camera, trimmed)
    view3d.frame(ax, extent, "white")
    return figure


def cloud_figure(plan: Scene, scenario: Scenario, boat: Body, scan: Scan) -> Figure:
    """Draw the points of one scan in 3-D (Fig. 3.6)."""
    points = to_world(scan.points, scan.pose)
    center = np.array([scan.pose[0], scan.pose[1], 0.0])
    camera = Camera(tuple((center + CLOUD_EYE_M).tolist()), tuple(center.tolist()))
    figure, ax = make_axes(
        f"{len(points):,} LiDAR points around the boat",
        f"scenario {scenario.name}, one scan from {scan.label}; dark outlines: plan of the harbor",
        (9.6, 6.6),
    )
    draw_ground(ax, camera, plan, scan.pose, CLOUD_RINGS_M)
    highest = max(1.0, math.ceil(points[:, 2].max())) if len(points) else 1.0
    dots = draw_cloud(ax, camera, points, highest)
    view3d.draw_bodies(ax, camera, [boat], shadows=False)
    background = palette.NIGHT_LAND if water(plan) == plan.bounds else palette.NIGHT_WATER
    view3d.frame(ax, view3d.extent(camera, center + CLOUD_EXTENT_M, ratio=1.8), background)
    bar = figure.colorbar(dots, ax=ax, orientation="horizontal", shrink=0.4, aspect=40, pad=0.02)
    bar.set_ticks([tick for tick in (0, 1, 2, 4, 6, 8, 10, 12, 15, 20, 30) if tick <= highest])
    bar.set_label("Height above the water [m]")
    bar.outline.set_visible(False)
    return figure


def sectors_figure(plan: Scene, scenario: Scenario, scan: Scan) -> Figure:
    """Draw the points of one scan from above, with the range in each sector (Fig. 3.9)."""
    figure, ax = make_axes(
        f"The {len(scan.ranges_m)} distances that the policy observes",
        f"scenario {scenario.name}, from {scan.label}: points from above, the nearest of each sector marked",
        (7.6, 8.1),
    )
    draw_sectors(ax, scan.points, scan.ranges_m, plan.hull, scan.range_m)
    return figure


def draw_cloud(ax: Axes, camera: Camera, points: Floats, highest_m: float) -> PathCollection:
    """Draw points (k, 3) [m] in the world frame, colored by height from 0 to `highest_m`, nearest on top."""
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


def draw_ground(ax: Axes, camera: Camera, scene: Scene, center: Floats, radii_m: Sequence[float]) -> None:
    """Draw the plan of the harbor in dark colors at z = 0, and labeled circles around the boat.

    Args:
        center: of the circles, x and y [m].
    """
    plan = [polygon.xy for polygon in scene.polygons if polygon.kind in ("quay", "finger", "hull", "mesh")]
    on_water = [camera.project(np.insert(xy, 2, 0.0, axis=1))[0] for xy in plan]
    view3d.draw_water(ax, camera, water(scene), palette.NIGHT_WATER)
    ax.add_collection(
        PolyCollection(on_water, fc=palette.NIGHT_LAND, ec=palette.NIGHT_RULE, lw=0.3, zorder=1.2)
    )
    turn = np.linspace(0, 2 * np.pi, 181)
    for radius in radii_m:
        circle = np.stack(
            [center[0] + radius * np.cos(turn), center[1] + radius * np.sin(turn), 0 * turn], axis=1
        )
        ring, _ = camera.project(circle)
        ax.plot(*ring.T, color=palette.WATER_DEEP, lw=0.7, ls=(0, (4, 3)), zorder=1.4)
        x, y = ring[np.argmin(ring[:, 1])]
        ax.text(x, y, f"{radius:g} m", ha="center", va="bottom", fontsize=7.5, color=palette.WATER)


def draw_sectors(ax: Axes, points: Floats, ranges_m: Floats, hull: Floats, range_m: float) -> None:
    """Draw points from above with the bow up, the sectors, and the nearest point of each sector.

    Args:
        points: (k, 3) returns in the body frame [m].
        ranges_m: (n,) nearest return of each sector, `range_m` if there is none.
        hull: (j, 2) outline of the boat in the body frame [m].
        range_m: maximum range of the sensor.
    """
    count = len(ranges_m)
    view = view_radius(ranges_m, range_m)
    edges = sector_edges_deg(count)
    for i in range(count):
        tint = palette.WATER if i % 2 else "#EAF3F7"
        ax.add_patch(
            Wedge((0, 0), 2 * view, edges[i] + 90, edges[i + 1] + 90, fc=tint, ec="white", lw=1.0, zorder=0)
        )
    step = next((step for step in SECTOR_RINGS_M if view / step <= 5), SECTOR_RINGS_M[-1])
    for radius in np.arange(step, view, step):
        ax.add_patch(Circle((0, 0), radius, fc="none", ec=palette.WATER_SHADE, lw=0.6, zorder=1))
    x, y = on_page(points)
    ax.plot(x, y, ".", ms=1.6, mew=0, color=palette.INK_SOFT, alpha=0.55, rasterized=True, zorder=2)
    sector = sector_index(np.arctan2(points[:, 1], points[:, 0]), count)
    for i, nearest in enumerate(ranges_m):
        inside = points[sector == i]
        is_hit = nearest < range_m and len(inside) > 0
        _draw_nearest(ax, i, inside if is_hit else None, float(nearest), np.radians(edges[i : i + 2]), view)
    ax.add_patch(Polygon(np.transpose(on_page(hull)), fc=palette.OWN_HULL, ec="white", lw=0.8, zorder=6))
    ax.set(aspect="equal", xlim=(-view, view), ylim=(-view, view))
    ticks = [tick for tick in ax.get_xticks() if abs(tick) < view]
    ax.set_xticks(ticks, [f"{0 - tick:g}".replace("-", "−") for tick in ticks])  # y points to port, left
    ax.set_yticks(ticks)
    ax.set(xlabel="y in the body frame, to port [m]", ylabel="x in the body frame, forward [m]")
    ax.grid(False)
    ax.spines[:].set_visible(True)


def _draw_nearest(
    ax: Axes, index: int, inside: Floats | None, nearest: float, edges: Floats, view: float
) -> None:
    """Mark and label the nearest of the points `inside` sector `index`, whose edges are (2,) [rad]."""
    if inside is None:
        text, azimuth, radius = f"d{index + 1}  no return", edges.mean(), 0.72 * view
    else:
        point = inside[np.argmin(np.hypot(inside[:, 0], inside[:, 1]))]
        x, y = on_page(point[None])
        ax.plot([0, x[0]], [0, y[0]], color=palette.GOAL, lw=1.1, zorder=4)
        ax.plot(x, y, "o", ms=5.5, color=palette.GOAL, mec="white", mew=0.9, zorder=5)
        # Away from the edges of the sector, where two sectors often have the same nearest corner.
        margin = 0.2 * (edges[1] - edges[0])
        azimuth = np.clip(np.arctan2(point[1], point[0]), edges[0] + margin, edges[1] - margin)
        text, radius = f"d{index + 1}  {nearest:.2f} m", min(nearest + 0.09 * view, 0.93 * view)
    (x_text,), (y_text,) = on_page(radius * np.array([[np.cos(azimuth), np.sin(azimuth)]]))
    at_edge = abs(x_text) > 0.7 * view
    outward = "center" if abs(x_text) < 0.3 * view else "left" if (x_text > 0) != at_edge else "right"
    ax.text(
        math.copysign(0.97 * view, x_text) if at_edge else x_text, y_text, text, ha=outward, va="center",
        fontsize=8.5, fontweight="bold", color=palette.INK, path_effects=HALO, zorder=7,
    )  # fmt: skip


def on_page(points: Floats) -> tuple[Floats, Floats]:
    """Return page coordinates, bow up and port left, of points (k, 2 or 3) in the body frame."""
    return -points[:, 1], points[:, 0]


def view_radius(ranges_m: Floats, range_m: float) -> float:
    """Return the half-width of the sector drawing [m]: around all nearest points, at most `LARGEST_VIEW_M`.

    Args:
        ranges_m: (sectors,) ranges of the sectors [m]; `range_m` without a return.
    """
    hits = ranges_m[ranges_m < range_m]
    return float(np.clip(1.35 * hits.max(), 6.0, LARGEST_VIEW_M)) if len(hits) else LARGEST_VIEW_M


def _list_poses(scenario: Scenario) -> str:
    task = scenario.task
    parts = [f"from {plan_view.pose_names(task.initial[:3])}{' …' if len(task.initial) > 3 else ''}"]
    if task.intermediate is not None:
        parts.append(f"via {plan_view.pose_names([task.intermediate])}")
    parts.append(f"to {plan_view.pose_names([task.final])}")
    return f"{' '.join(parts)}; x [m], y [m], heading"
