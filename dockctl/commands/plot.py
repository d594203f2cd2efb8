"""``dockctl plot``: figures of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from dockctl.commands.options import latest_run_or_recording, print_paths, save_figures
from dockctl.console import print_text


def plot(
    run: Annotated[
        Path | None,
        typer.Argument(
            metavar="RUN",
            help="Run folder, or recording of dockctl evaluate; the latest run in ./runs by default, or a"
            " recording of a shipped policy if there is no run.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Output folder; <run>/figures by default.")] = None,
) -> None:
    """Draw training curves and the trajectories of the best policy (PNG, SVG) from a run folder.

    Example: dockctl plot --out figures/latest
    """
    from dockctl.reports.figures import figures
    from dockctl.run_files import DRAWN, FIGURES
    from dockctl.runs.reader import SOURCES, read_run
    from dockctl.runs.results import hashes_of, write_results

    folder = latest_run_or_recording()[0] if run is None else run
    sources = hashes_of(folder / name for name in SOURCES)
    data = read_run(folder)
    if data.missing:
        note = f"note: {folder} has no rows in {', '.join(data.missing)}; their figures are omitted"
        print_text(Console(stderr=True), note, "yellow")
    figure_folder = out or folder / FIGURES
    drawn = save_figures(lambda: dict(figures(data)), figure_folder)
    print_paths([write_results(figure_folder / Path(DRAWN).name, {}, sources | hashes_of(drawn))])
