"""``dockctl report``: one page with everything that is known about a run, a study or a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from dockctl.commands.options import Trust, latest_run, latest_run_or_recording, print_paths


def report(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="RUN|STUDY|COMPARISON",
            help="Run folder, folder of a study's results, or file of dockctl compare --json;"
            " the latest run by default, or a recording of a shipped policy if there is no run.",
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="The page; report-<name>.html by default.")] = None,
    follow: Annotated[bool, typer.Option("--follow", help="Rewrite the page until training ends.")] = False,
    trust: Trust = False,
) -> None:
    """Write one HTML page that works offline: figures with values, tables and the 3-D replay.

    Example: dockctl report --out report.html
    """
    from dockctl.experiments import report
    from dockctl.runs.files import require_writable_file

    if out:
        require_writable_file(out, ".html")

    def note(text: str) -> None:
        typer.echo(text, err=True)

    if follow:
        source = source or latest_run(unsaved=True)
        with Console(stderr=True).status("following the run"):
            page = report.follow(source, out, trust=trust, note=note)
    else:
        folder, policy = (source, None) if source else latest_run_or_recording()
        with Console(stderr=True).status("writing the report"):
            page = report.write_report(folder, out, policy=policy, trust=trust, note=note)
    print_paths([page])
