"""``dockctl plot``: figures of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import save_figures


def plot(
    run: Annotated[Path | None, typer.Argument(help="Run folder; the latest in ./runs by default.")] = None,
    out: Annotated[Path | None, typer.Option(help="Output folder; <run>/figures by default.")] = None,
) -> None:
    """Draw the training and the trajectories of the best policy (PNG, SVG) from a run folder.

    Example: dockctl plot runs/s3/20250101-120000-seed0
    """
    from dockctl.reports.figures import figures
    from dockctl.runs.directory import FIGURES, RUNS, RunDirectory
    from dockctl.runs.reader import read_run

    folder = RunDirectory.latest(RUNS).path if run is None else run
    data = read_run(folder)
    if data.missing:
        note = f"note: {folder} has no rows in {', '.join(data.missing)}; their figures are left out"
        typer.secho(note, fg="yellow", err=True)
    save_figures(lambda: dict(figures(data)), out or folder / FIGURES)
