"""``dockctl map``: from where does a policy dock?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Elsewhere, finite

HEADINGS = "0,20,-20,45,-45,90,-90,180"


def map_(
    ckpt: Annotated[
        Path | None,
        typer.Option(help="Run folder, checkpoint, or name of a shipped one; the latest run by default."),
    ] = None,
    scenario: Elsewhere = None,
    reach_m: Annotated[
        float, typer.Option(min=0, max=1000, callback=finite, help="± in x and in y [m].")
    ] = 10.0,
    step_m: Annotated[
        float, typer.Option(min=0.01, max=1000, callback=finite, help="Between two starts [m].")
    ] = 2.0,
    headings: Annotated[
        str, typer.Option(metavar="DEGREES,…", help="By which the starts are turned [°].")
    ] = HEADINGS,
    csv: Annotated[Path | None, typer.Option(help="Write one row a start here, too.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of table and figure; the run folder, or figures/map, by default."),
    ] = None,
) -> None:
    """Play greedy episodes from a grid of starts around the first initial pose, and draw which of them dock.

    Starts at which the boat has no room are marked as blocked and do not count.

    Example: dockctl map --ckpt runs/s3/20250101-120000-seed0 --reach-m 6 --headings 0,20,-20
    """
    from dockctl.evaluation import success_map as mapping

    mapping.chart(ckpt, scenario, mapping.Grid.of(reach_m, step_m, headings), csv, out)
