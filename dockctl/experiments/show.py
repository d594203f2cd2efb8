"""What ``dockctl show`` draws of a scenario: harbor, poses, berths, generated layouts and one LiDAR scan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.evaluation.starts import layout_harbor
from dockctl.geometry import Floats, pose_array
from dockctl.reports.show import MAX_LAYOUTS, Scan, figures, layouts_figures
from dockctl.reports.style import Draw
from dockctl.reports.view3d import Body
from dockctl.scenarios.base import Pose
from dockctl.scenarios.harbor import Generated, Marina, berth_pose, docked_gap
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import PoseCheck
from dockctl.sim.harbor.build import Harbor, build_harbor, build_scene
from dockctl.sim.harbor.solids import hull_mesh
from dockctl.sim.starts import own_site, sites
from dockctl.sim.world import build_sensor, scan_points, scan_sectors


@dataclass(frozen=True, eq=False)
class Shown:
    """A scan from a pose, and a function that draws the figures, by file name."""

    pose: Pose
    scan: Scan
    draw: Draw


def show(loaded: LoadedScenario, pose: Pose | None = None) -> Shown:
    """Take a scan from `pose`, by default from the first initial pose.

    Raises:
        DockctlError: the pose that the user gave with ``--pose`` is not free.
    """
    scenario = loaded.scenario
    harbor = layout_harbor(loaded, own_site(scenario).harbor)
    start = pose or scenario.task.initial[0]
    if problem := PoseCheck.build(scenario, harbor).problem(start):
        raise DockctlError(f"--pose: {problem}" if pose else problem)
    eta, spec = pose_array(start), scenario.sensors.lidar
    sensor = build_sensor(harbor, spec)
    points = scan_points(sensor, spec.kind, eta)
    scan = Scan(eta, points, scan_sectors(sensor, spec, eta), spec.range_m)
    plan, bodies = build_scene(harbor, scenario.vessel.hull), _bodies(scenario, harbor)
    return Shown(
        start,
        scan,
        lambda: {
            **figures(plan, scenario, *bodies, scan, berths(scenario)),
            **layouts_figures(scenario, *_drawn_layouts(scenario)),
        },
    )


def _bodies(scenario: Scenario, harbor: Harbor) -> tuple[list[Body], Body]:
    """Return the solids of the harbor in the world frame, and our boat's hull in the body frame."""
    solids = [(part.name, solid) for part in harbor.parts for solid in part.solids]
    return (
        [Body(name, solid.kind, np.array(solid.mesh.triangles)) for name, solid in solids],
        Body("own boat", "own", np.array(hull_mesh(scenario.vessel.hull).triangles)),
    )


def berths(scenario: Scenario) -> dict[str, Floats]:
    """Return the final poses (k, 3) at the berths of the task, by kind; empty for a task with one berth."""
    poses: dict[str, list[Floats]] = {}
    for site in sites(scenario):
        if site.kind and not (isinstance(scenario.harbor, Generated) and site.harbor):
            poses.setdefault(site.kind, []).append(site.goals[1])
    return {kind: np.unique(found, axis=0) for kind, found in poses.items()}


def _drawn_layouts(scenario: Scenario) -> tuple[list[tuple[Scene, Floats]], int]:
    """Return plan views of the first generated layouts with free berths (k, 3), and the number of layouts."""
    every = layouts(scenario.harbor, scenario.task.berths)
    if not isinstance(scenario.harbor, Generated) or len(every) == 1:
        return [], 0
    drawn = []
    for layout in every[:MAX_LAYOUTS]:
        assert isinstance(layout.harbor, Marina)  # as every generated layout
        hull, final = scenario.vessel.hull, pose_array(scenario.task.final)
        gap_m = docked_gap([(layout.harbor, place) for place in layout.berths], final, hull.length_m)
        free = np.array([berth_pose(layout.harbor, place, gap_m) for place in layout.berths])
        drawn.append((build_scene(build_harbor(layout.harbor, Path()), hull), free))
    return drawn, len(every)
