"""``dockctl report``: one page with everything that is known of a run, a study or a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from dockctl.commands.options import Trust, latest_run, print_paths


def report(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="RUN|STUDY|COMPARISON",
            help="Run folder, folder of a study's results, or file of dockctl compare --json;"
            " the latest run by default.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The page; report-<name>.html by default.")] = None,
    follow: Annotated[
        bool, typer.Option("--follow", help="Rewrite the page until the training ends.")
    ] = False,
    trust: Trust = False,
) -> None:
    """Write one HTML page that opens without a network: figures with values, tables and the 3-D replay.

    Example: dockctl report --out report.html
    """
    from dockctl.experiments import report
    from dockctl.runs.files import require_writable_file

    if out:
        require_writable_file(out, ".html")

    def note(text: str) -> None:
        typer.echo(text, err=True)

    source = source or latest_run(unsaved=follow)
    write = report.follow if follow else report.write_report
    with Console(stderr=True).status("following the training" if follow else "writing the report"):
        page = write(source, out, trust=trust, note=note)
    print_paths([page])
