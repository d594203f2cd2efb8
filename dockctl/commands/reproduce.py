"""``dockctl reproduce``: every training and measurement of a study, and the pages that show them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.experiments.interrupt import INTERRUPTED

FAILED = 1


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
    results: Annotated[Path, typer.Option(help="Folder that keeps the small files of every run.")] = Path(
        "results"
    ),
    docs: Annotated[Path, typer.Option(help="Folder of the pages and their figures.")] = Path("docs"),
    pages: Annotated[
        bool, typer.Option("--pages", help="Train nothing; keep what is finished, and write the pages.")
    ] = False,
    unfinished: Annotated[
        bool, typer.Option("--unfinished", help="Keep trainings under way, too; the pages say so.")
    ] = False,
) -> None:
    """Train, evaluate and plot everything that the results pages show, and write them.

    What is there already is not done again, and an interrupted training is taken up where it was.

    Example: dockctl reproduce s1 s2 s3
    """
    from dockctl.compute.threads import usable_cores
    from dockctl.experiments import publishing
    from dockctl.experiments import study as reproduction

    if pages:
        publishing.publish(study, names or [], out, results, docs, unfinished=unfinished)
        return
    ending = reproduction.carry_out(study, names or [], out, jobs or usable_cores())
    if ending == "interrupted":
        raise typer.Exit(INTERRUPTED)
    publishing.publish(study, names or [], out, results, docs, unfinished=unfinished)
    if ending == "failed":
        raise typer.Exit(FAILED)
