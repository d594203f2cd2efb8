"""``dockctl record``: the way that a policy takes, for ``dockctl plot``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Ckpt, Elsewhere


def record(
    ckpt: Ckpt = None,
    scenario: Elsewhere = None,
    pose: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y,HEADING", help="Start [m, m, °], one or more; the test poses by default."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the recording; transfer/<scenario> in the run folder by default."),
    ] = None,
) -> None:
    """Play greedy episodes and record every step of them; dockctl plot draws the folder like a run.

    Example: dockctl record --ckpt runs/s3/20250101-120000-seed0 --scenario s3-opposite
    """
    from dockctl.evaluation import record as recording

    recording.record(ckpt, scenario, pose or [], out)
