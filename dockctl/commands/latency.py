"""``dockctl latency``: how long a decision takes on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Ckpt


def latency(
    ckpt: Ckpt = None,
    scenario: Annotated[
        str | None, typer.Option(help="Scenario file or name; the one of the training, or s3, by default.")
    ] = None,
    decisions: Annotated[
        int, typer.Option(min=10, max=1_000_000, help="At least so many are timed, over whole episodes.")
    ] = 500,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder of the results; that of the run's figures, or figures/latency, by default."
        ),
    ] = None,
) -> None:
    """Time LiDAR scan, state and forward pass of greedy decisions.

    Where there is no run, a new network with random weights is timed, which takes as long as a trained one.

    Writes a histogram (PNG, SVG), every sample (CSV) and the summary (JSON).

    Example: dockctl latency --ckpt runs/s3/20250101-120000-seed0
    """
    from dockctl.evaluation import latency as timing

    timing.latency(ckpt, scenario, decisions, out)
