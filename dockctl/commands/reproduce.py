"""``dockctl reproduce``: every training and measurement of a study, and the pages that show them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

FAILED, INTERRUPTED = 1, 130


def reproduce(
    names: Annotated[
        list[str] | None, typer.Argument(help="Experiments or groups of the study; all if none is given.")
    ] = None,
    study: Annotated[str, typer.Option(help="Study file, or the name of a packaged one.")] = "thesis",
    out: Annotated[Path, typer.Option(help="Gets <experiment>/<scenario>/<time>-seed<N>/.")] = Path(
        "runs/reproduce"
    ),
    jobs: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Trainings side by side.", show_default="cores")
    ] = None,
) -> None:
    """Train, evaluate and plot everything that the results page shows.

    What is there already is not done again, and an interrupted training is taken up where it was.

    Example: dockctl reproduce s1 s2 s3
    """
    from dockctl.commands import reproduction

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    ending = reproduction.carry_out(study, names or [], out, jobs or cores)
    if ending != "done":
        raise typer.Exit({"failed": FAILED, "interrupted": INTERRUPTED}[ending])
