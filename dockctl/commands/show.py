"""``dockctl show``: draw a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from dockctl.commands.options import (
    Json,
    Overrides,
    Plugins,
    Trust,
    parse_pose,
    save_figures,
)
from dockctl.console import make_table, numeric, print_table, print_text
from dockctl.run_files import FIGURES
from dockctl.scenarios.catalog import DEFAULT_SCENARIO

if TYPE_CHECKING:
    from dockctl.reports.show import Scan


def show(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Scenario file or name.")
    ] = DEFAULT_SCENARIO,
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
    """Draw the harbor, the poses and a LiDAR scan (PNG, SVG); print the range in each sector.

    Example: dockctl show s3 --pose 30,0.5,175
    """
    from dockctl.experiments.show import show as run
    from dockctl.runs.files import require_writable
    from dockctl.sim.checks import load_checked

    loaded = load_checked(scenario, overrides=set_ or (), plugin_files=plugin or (), trust=trust)
    name = loaded.scenario.name
    folder = out or Path(FIGURES) / "show" / name
    require_writable(folder)
    shown = run(loaded, None if pose is None else parse_pose(pose))
    scan = shown.scan
    console = Console()
    print_text(console, f"{len(scan.points):,} LiDAR points from {scan.label}")
    print_table(console, sector_table(scan))
    if json_:
        sectors = scan.ranges_m.tolist()
        json_.write({"scenario": name, "pose": shown.pose.model_dump(), "sectors_m": sectors})
    save_figures(shown.draw, folder)


def sector_table(scan: Scan) -> Table:
    """Return the table of the range in each sector."""
    from dockctl.geometry import sector_edges_deg

    table = make_table(*numeric("sector", "from", "to", "nearest"))
    edges = sector_edges_deg(len(scan.ranges_m))
    for i, distance in enumerate(scan.ranges_m):
        nearest = f"{distance:.3f} m" if distance < scan.range_m else f"no return within {scan.range_m:g} m"
        table.add_row(f"d{i + 1}", f"{edges[i]:g}°", f"{edges[i + 1]:g}°", nearest)
    return table
