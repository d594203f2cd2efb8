"""``dockctl show``: what a scenario looks like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import DEFAULT_SCENARIO


def show(
    scenario: Annotated[str, typer.Argument(help="Scenario file or name.")] = DEFAULT_SCENARIO,
    pose: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,HEADING",
            help="Where the LiDARs scan, in m and °; the first initial pose by default.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder of the drawings; figures/<scenario> by default.")
    ] = None,
    plugin: Annotated[
        list[Path] | None, typer.Option(help="Local .py file with reward terms or parts.")
    ] = None,
) -> None:
    """Draw the harbor, the poses and what the LiDARs see (PNG, SVG); print the distance in each sector.

    Example: dockctl show s3 --pose 30,0.5,175
    """
    from dockctl.commands import drawing

    drawing.show(scenario, pose, out, plugin or [])
