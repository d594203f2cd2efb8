"""``dockctl show``: draw a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from dockctl.commands.options import (
    DEFAULT_SCENARIO,
    Json,
    Overrides,
    Plugins,
    Trust,
    parse_pose,
    save_figures,
)
from dockctl.console import make_table, numeric, print_table, print_text
from dockctl.errors import DockctlError
from dockctl.runs.directory import FIGURES

if TYPE_CHECKING:
    from dockctl.drawing.scene import Scene
    from dockctl.geometry import Floats
    from dockctl.reports.show import Scan
    from dockctl.reports.view3d import Body
    from dockctl.scenarios.base import Pose
    from dockctl.scenarios.schema import Scenario
    from dockctl.sim.harbor.build import Harbor


def show(
    scenario: Annotated[str, typer.Argument(help="Scenario file or name.")] = DEFAULT_SCENARIO,
    pose: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,HEADING",
            help="Pose of the LiDAR scan [m, m, °]; the first initial pose by default.",
        ),
    ] = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    json_: Json = None,
    out: Annotated[
        Path | None, typer.Option(help="Output folder; figures/show/<scenario> by default.")
    ] = None,
) -> None:
    """Draw the harbor, the poses and a LiDAR scan (PNG, SVG); print the distance in each sector.

    Example: dockctl show s3 --pose 30,0.5,175
    """
    from dockctl.reports.show import figures, layouts_figures
    from dockctl.runs.files import require_writable
    from dockctl.sim.harbor.build import build_harbor, build_scene
    from dockctl.sim.world import PoseCheck, load_checked

    loaded = load_checked(scenario, overrides=set_ or (), plugin_files=plugin or (), trust=trust)
    spec = loaded.scenario
    harbor = build_harbor(spec.harbor, loaded.base_dir)
    start = spec.task.initial[0] if pose is None else parse_pose(pose)
    if problem := PoseCheck.build(spec, harbor).problem(start):
        raise DockctlError(f"--pose {pose}: {problem}")
    folder = out or Path(FIGURES) / "show" / spec.name
    require_writable(folder)
    measured = scan(spec, harbor, start)
    console = Console()
    print_text(console, f"{len(measured.points):,} LiDAR points from {measured.label}")
    print_table(console, sector_table(measured))
    if json_:
        sectors = measured.ranges_m.tolist()
        json_.write({"scenario": spec.name, "pose": start.model_dump(), "sectors_m": sectors})
    plan = build_scene(harbor, spec.vessel.hull)
    save_figures(
        lambda: {
            **figures(plan, spec, *bodies(spec, harbor), measured, berths(spec)),
            **layouts_figures(spec, *drawn_layouts(spec)),
        },
        folder,
    )


def scan(scenario: Scenario, harbor: Harbor, pose: Pose) -> Scan:
    """Take one LiDAR scan from a pose."""
    from dockctl.geometry import pose_array
    from dockctl.reports.show import Scan

    eta = pose_array(pose)
    sensor = scenario.sensors.lidar.build(harbor.triangles)
    return Scan(eta, sensor.points(eta), sensor.sector_ranges(eta[None])[0], scenario.sensors.lidar.range_m)


def bodies(scenario: Scenario, harbor: Harbor) -> tuple[list[Body], Body]:
    """Return the solids of the harbor in the world frame, and our hull in the body frame."""
    import numpy as np

    from dockctl.reports.view3d import Body
    from dockctl.sim.harbor.solids import hull_mesh

    solids = [(part.name, solid) for part in harbor.parts for solid in part.solids]
    return (
        [Body(name, solid.kind, np.array(solid.mesh.triangles)) for name, solid in solids],
        Body("own boat", "own", np.array(hull_mesh(scenario.vessel.hull).triangles)),
    )


def berths(scenario: Scenario) -> dict[str, Floats]:
    """Return the final poses (k, 3) at the berths of the task, by kind; empty for a task of one berth."""
    import numpy as np

    from dockctl.scenarios.harbor import Generated
    from dockctl.sim.starts import sites

    poses: dict[str, list[Floats]] = {}
    for site in sites(scenario):
        if site.kind and not (isinstance(scenario.harbor, Generated) and site.harbor):
            poses.setdefault(site.kind, []).append(site.goals[1])
    return {kind: np.unique(found, axis=0) for kind, found in poses.items()}


def drawn_layouts(scenario: Scenario) -> tuple[list[tuple[Scene, Floats]], int]:
    """Return plan views of the first generated layouts with their free berths (k, 3), and their number."""
    import numpy as np

    from dockctl.reports.show import MAX_LAYOUTS
    from dockctl.scenarios.harbor import Generated
    from dockctl.scenarios.layouts import layouts
    from dockctl.sim.harbor.build import build_harbor, build_scene

    every = layouts(scenario.harbor, scenario.task.berths)
    if not isinstance(scenario.harbor, Generated) or len(every) == 1:
        return [], 0
    drawn = []
    for layout in every[:MAX_LAYOUTS]:
        harbor = build_harbor(layout.harbor, Path())
        free = np.array([berth.pose for berth in harbor.berths if not berth.occupied])
        drawn.append((build_scene(harbor, scenario.vessel.hull), free))
    return drawn, len(every)


def sector_table(scan: Scan) -> Table:
    """Return the table of the distance in each sector."""
    table = make_table(*numeric("sector", "from", "to", "nearest"))
    width = 360 / len(scan.ranges_m)
    for i, distance in enumerate(scan.ranges_m):
        nearest = f"{distance:.3f} m" if distance < scan.range_m else f"no return within {scan.range_m:g} m"
        table.add_row(f"d{i + 1}", f"{i * width - 180:g}°", f"{(i + 1) * width - 180:g}°", nearest)
    return table
