"""``dockctl returns``: which behavior does the reward of a scenario prefer?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def returns(
    scenario: Annotated[
        str | None, typer.Argument(help="Scenario file or name; the one of the training by default.")
    ] = None,
    ckpt: Annotated[
        Path | None,
        typer.Option(help="Run folder, checkpoint, or name of a shipped one; the latest run by default."),
    ] = None,
    units: Annotated[
        str,
        typer.Option(
            metavar="METERS,…", help="Units of the distance in the reward, each a reading of it [m]."
        ),
    ] = "20,1",
    csv: Annotated[Path | None, typer.Option(help="Write the table here, too.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of table and figure; the run folder, or figures/returns, by default."),
    ] = None,
) -> None:
    """Compare the discounted returns of docking, of colliding and of loitering.

    A greedy episode of the policy shows how to dock; the other behaviors are commands held. All are played
    once from the first initial pose, and the reward's own terms judge them under every reading.

    Example: dockctl returns s3 --ckpt runs/s3/20250101-120000-seed0
    """
    from dockctl.evaluation import returns as returning

    returning.compare(ckpt, scenario, returning.readings(units), csv, out)
