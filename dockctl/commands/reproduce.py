"""``dockctl reproduce``: run all training and measurements of a study."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import On
from dockctl.experiments.interrupt import INTERRUPTED
from dockctl.run_files import RUNS

FAILED = 1
THESIS = "thesis"


def reproduce(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="NAME", help="Experiments or groups of the study; all by default."),
    ] = None,
    study: Annotated[str, typer.Option(help="Study file or name of a packaged study.")] = THESIS,
    out: Annotated[
        Path,
        typer.Option(
            help="Output folder; a run is in <study>/<experiment>/<scenario>/<time>-seed<N>/ below it."
        ),
    ] = RUNS / "reproduce",
    jobs: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Number of parallel jobs.", show_default="cores")
    ] = None,
    on: On = None,
    results: Annotated[
        Path, typer.Option(help="Archive folder; a run is in <study>/<experiment>/seed<N>/ below it.")
    ] = Path("results"),
) -> None:
    """Run all experiments of a study, and archive the small files of every finished run.

    Finished work is not repeated, and interrupted runs are resumed.

    Example: dockctl reproduce s1 s2 s3
    """
    from dockctl.experiments.runner import run_study

    ending = run_study(study, names or [], out, results, jobs, on)
    if ending == "interrupted":
        raise typer.Exit(INTERRUPTED)
    if study == THESIS:
        print("To write the results pages in a source checkout: make results")
    if ending == "failed":
        raise typer.Exit(FAILED)
