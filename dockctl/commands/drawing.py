"""Scan from a pose and draw a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from dockctl.console import say
from dockctl.errors import DockctlError
from dockctl.geometry import pose_array
from dockctl.reports.show import Scan, figures
from dockctl.reports.style import house_style, save
from dockctl.reports.view3d import Body
from dockctl.runs.directory import require_writable
from dockctl.scenarios.base import Pose
from dockctl.sim.checks import PoseCheck, load_checked
from dockctl.sim.harbor.build import build_harbor, scene_of
from dockctl.sim.hull import hull_mesh

FARTHEST = 10_000
"""Metres or degrees; nobody moors a harbor that far from its origin."""


def show(source: str, pose: str | None, out: Path | None, plugin_files: Sequence[Path]) -> None:
    """Draw the scenario called `source` and print what the LiDARs see from `pose`.

    Raises:
        DockctlError: the scenario or the pose is wrong, or the drawings cannot be written.
    """
    loaded = load_checked(source, plugin_files=plugin_files)
    scenario = loaded.scenario
    harbor = build_harbor(scenario.harbor, loaded.base_dir)
    where = scenario.task.initial[0] if pose is None else pose_of(pose)
    if flaw := PoseCheck.of(scenario, harbor).flaw(where):
        raise DockctlError(f"--pose {pose}: {flaw}")
    place = pose_array(where)
    folder = out or Path("figures") / scenario.name
    require_writable(folder)
    lidar = scenario.sensors.lidar.build(harbor.triangles)
    points = lidar.points(place)
    ranges = lidar.sector_ranges(place[None])[0]
    scan = Scan(place, points, ranges, scenario.sensors.lidar.range_m)
    bodies = [
        Body(part.name, solid.kind, np.array(solid.mesh.triangles))
        for part in harbor.parts
        for solid in part.solids
    ]
    own = Body("own boat", "own", np.array(hull_mesh(scenario.vessel.hull).triangles))
    with house_style():
        drawn = figures(scene_of(harbor, scenario.vessel.hull), scenario, bodies, own, scan)
        written = save(drawn, folder)
    console = Console()
    say(console, f"{len(scan.points):,} LiDAR points from {scan.label}")
    console.print(sector_table(scan))
    for path in written:
        say(console, str(path))


def sector_table(scan: Scan) -> Table:
    """The distances of a scan, sector by sector."""
    table = Table(box=box.SIMPLE_HEAD)
    for name in ("sector", "from", "to", "nearest"):
        table.add_column(name, justify="right")
    edges = np.linspace(-180.0, 180.0, len(scan.ranges_m) + 1)
    for i, distance in enumerate(scan.ranges_m):
        seen = f"{distance:.3f} m" if distance < scan.range_m else f"nothing within {scan.range_m:g} m"
        table.add_row(f"d{i + 1}", f"{edges[i]:g}°", f"{edges[i + 1]:g}°", seen)
    return table


def pose_of(text: str) -> Pose:
    """Read ``x,y,heading`` [m, m, degrees].

    Raises:
        DockctlError: it is something else.
    """
    try:
        x, y, heading = (float(part) for part in text.split(","))
    except ValueError:
        raise DockctlError(
            f"--pose '{text}': give three numbers, x,y,heading in m, m and degrees, like 20,2,160"
        ) from None
    if not all(abs(number) <= FARTHEST for number in (x, y, heading)):
        raise DockctlError(f"--pose '{text}': the numbers must lie within +- {FARTHEST:,}")
    return Pose(x_m=x, y_m=y, heading_deg=heading)
