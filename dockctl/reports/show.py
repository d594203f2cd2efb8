"""The drawings of a scenario: harbor and poses from above, the marina in 3-D, what the LiDARs see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from dockctl.analysis.trajectories import pose_label
from dockctl.drawing import palette
from dockctl.drawing.plan import water
from dockctl.drawing.scene import Scene
from dockctl.reports import cloud, plan_view, view3d
from dockctl.reports.style import titled_axes, titled_figure
from dockctl.reports.view3d import Body, Camera
from dockctl.scenarios.schema import Scenario

Floats = NDArray[np.float64]

QUAY_STRIP_M = 5.0
RINGS_M = (10.0, 20.0, 30.0)
HEIGHT_SHARES = (0.5, 0.6)  # of the view over the marina, the first choice first
TURNS_DEG = (0.0, -4.0, 4.0, -8.0, 8.0, -12.0, 12.0)
CLOUD_EYE_M = np.array([-46.0, -30.0, 30.0])  # from the boat
CLOUD_REACH_M = np.array(
    [[-24, -24, 0], [24, -24, 0], [-24, 24, 0], [24, 24, 0], [0, 20, 12]]
)  # of the picture


@dataclass(frozen=True, eq=False)
class Scan:
    """One scan: pose (x [m], y [m], heading [rad]), (k, 3) body-frame returns [m], sector ranges [m]."""

    pose: Floats
    points: Floats
    ranges_m: Floats
    range_m: float

    @property
    def label(self) -> str:
        return pose_label(self.pose[0], self.pose[1], math.degrees(self.pose[2]))


def figures(
    plan: Scene, scenario: Scenario, bodies: Sequence[Body], own: Body, scan: Scan
) -> dict[str, Figure]:
    """Return the four drawings by file name.

    Args:
        plan: harbor and boat from above.
        bodies: the harbor's solids in the world frame.
        own: the own boat in the body frame.
        scan: what the LiDARs see from one pose.
    """
    plan = plan_view.embracing(plan, plan_view.task_points(scenario.task, scenario.evaluation.poses))
    boat = Body(own.name, own.kind, view3d.placed(own.triangles, scan.pose))
    return {
        "harbor": harbor_figure(plan, scenario),
        "marina-3d": marina_figure(plan, scenario, [*bodies, boat]),
        "point-cloud": cloud_figure(plan, scenario, boat, scan),
        "sectors": sectors_figure(plan, scenario, scan),
    }


def harbor_figure(plan: Scene, scenario: Scenario) -> Figure:
    """The whole harbor, and the poses of the task close up (Figs. 3.13-3.15)."""
    task, tests = scenario.task, scenario.evaluation.poses
    whole = plan_view.whole_view(plan)
    close = plan_view.close_view(plan, plan_view.task_points(task, tests), aspect=(1.0, 1.0))
    shape = (whole[2] - whole[0]) / (whole[3] - whole[1])
    height = 8.2
    overall = float(np.clip((height - 1.2) * shape + 0.7, 2.6, 9.0))
    figure = titled_figure(
        f"Harbor and poses of scenario {scenario.name}", _poses_line(scenario), (overall + 7.4, height)
    )
    left, right = figure.subplots(1, 2, width_ratios=(overall, 7.2))
    plan_view.draw_harbor(left, plan, whole)
    x, y, width, depth = close[0], close[1], close[2] - close[0], close[3] - close[1]
    left.add_patch(Rectangle((x, y), width, depth, fc="none", ec=palette.INK, lw=1.1, zorder=7))
    plan_view.draw_harbor(right, plan, close)
    for ax, named in ((left, False), (right, True)):
        plan_view.draw_poses(ax, plan, task, tests, named=named)
    plan_view.draw_compass(right, close)
    return figure


def marina_figure(plan: Scene, scenario: Scenario, bodies: Sequence[Body]) -> Figure:
    """The marina in three dimensions, with the own boat in red."""
    sea = water(plan)
    x0, y0, x1, y1 = sea
    edge = np.array(
        [[x0 - QUAY_STRIP_M, y0 - QUAY_STRIP_M, -np.inf], [x1 + QUAY_STRIP_M, y1 + QUAY_STRIP_M, np.inf]]
    )
    trimmed = [Body(body.name, body.kind, np.clip(body.triangles, *edge)) for body in bodies]
    views = [view3d.overlook(sea, turn, height) for height in HEIGHT_SHARES for turn in TURNS_DEG]
    own = [body.triangles for body in trimmed if body.kind == "own"]
    others = [body.triangles for body in trimmed if body.kind != "own"]
    camera = view3d.clearest(views, np.concatenate(own), np.concatenate(others))
    corners = np.array([[x, y, 0.0] for x in edge[:, 0] for y in edge[:, 1]])
    tops = np.concatenate([body.triangles.reshape(-1, 3) for body in trimmed])
    extent = view3d.extent(camera, np.concatenate([corners, tops[tops[:, 2] > 0]]))
    width, height = extent[1] - extent[0]
    figure, ax = titled_axes(
        f"The harbor '{plan.name}'",
        f"scenario {scenario.name}; the boat that learns to dock is red",
        (10.4, 10.0 * height / width + 0.9),
    )
    view3d.draw_water(ax, camera, sea)
    view3d.draw_bodies(ax, camera, trimmed)
    view3d.frame(ax, extent, "white")
    return figure


def cloud_figure(plan: Scene, scenario: Scenario, boat: Body, scan: Scan) -> Figure:
    """The points of one scan in three dimensions (Fig. 3.6)."""
    points = view3d.placed(scan.points, scan.pose)
    centre = np.array([scan.pose[0], scan.pose[1], 0.0])
    camera = Camera(tuple((centre + CLOUD_EYE_M).tolist()), tuple(centre.tolist()))
    figure, ax = titled_axes(
        f"{len(points):,} LiDAR points around the boat",
        f"scenario {scenario.name}, one scan from {scan.label}; dark outlines: the harbor's plan",
        (9.6, 6.6),
    )
    cloud.draw_ground(ax, camera, plan, scan.pose, RINGS_M)
    highest = max(1.0, math.ceil(points[:, 2].max())) if len(points) else 1.0
    dots = cloud.draw_cloud(ax, camera, points, highest)
    view3d.draw_bodies(ax, camera, [boat], shadows=False)
    around = palette.NIGHT_LAND if water(plan) == plan.bounds else palette.NIGHT_WATER
    view3d.frame(ax, view3d.extent(camera, centre + CLOUD_REACH_M, ratio=1.8), around)
    bar = figure.colorbar(dots, ax=ax, orientation="horizontal", shrink=0.4, aspect=40, pad=0.02)
    bar.set_ticks([tick for tick in (0, 1, 2, 4, 6, 8, 10, 12, 15, 20, 30) if tick <= highest])
    bar.set_label("Height above the water [m]")
    bar.outline.set_visible(False)
    return figure


def sectors_figure(plan: Scene, scenario: Scenario, scan: Scan) -> Figure:
    """The points from above in their sectors, with the distances that the policy sees (Fig. 3.9)."""
    figure, ax = titled_axes(
        f"The {len(scan.ranges_m)} distances that the policy sees",
        f"scenario {scenario.name}, from {scan.label}: points from above, the nearest of each sector marked",
        (7.6, 8.1),
    )
    cloud.draw_sectors(ax, scan.points, scan.ranges_m, plan.hull, scan.range_m)
    return figure


def _poses_line(scenario: Scenario) -> str:
    task = scenario.task
    ways = [f"from {plan_view.pose_names(task.initial[:3])}{' …' if len(task.initial) > 3 else ''}"]
    if task.intermediate is not None:
        ways.append(f"by {plan_view.pose_names([task.intermediate])}")
    ways.append(f"to {plan_view.pose_names([task.final])}")
    return f"{' '.join(ways)}; x [m], y [m], heading"
