"""``dockctl verify``: does a training run repeat on this machine?"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from dockctl.commands.options import Json, Plugins, Trust, latest_run
from dockctl.console import make_table, numeric, print_table, print_text

DIFFERENT = 1


def verify(
    run: Annotated[
        Path | None, typer.Argument(metavar="RUN", help="Run folder; the latest in ./runs by default.")
    ] = None,
    steps: Annotated[
        int, typer.Option(min=1, help="Number of environment steps to repeat, summed over all boats.")
    ] = 10_000,
    plugin: Plugins = None,
    trust: Trust = False,
    json_: Json = None,
) -> None:
    """Repeat the first steps of a run in a temporary folder, and compare the tables with those of the run.

    Prints what differs between the machine of the run and this one: software, processor, plugins. Exits with
    0 if all rows are equal, and with 1 if one differs. A seed gives the same rows on the same machine; on a
    different machine, rounding may differ.

    Example: dockctl verify --steps 5000
    """
    from dockctl.experiments.verify import verify as repeat

    run = run or latest_run()
    with Console(stderr=True).status("repeating the run"):
        result = repeat(run, steps, plugin_files=plugin or (), trust=trust)
    if json_:
        json_.write(asdict(result))
    console = Console()
    table = make_table("table", *numeric("rows", "SHA-256"), "", title=f"The first {result.steps:,} steps")
    for check in result.tables:
        verdict = Text(check.difference, "red") if check.difference else Text("equal", "green")
        table.add_row(check.name, f"{check.rows:,}", check.here[:16], verdict)
    print_table(console, table)
    if result.conditions:
        table = make_table("differs here", "in the run", "here")
        for row in result.conditions:
            table.add_row(*map(Text, row))
        print_table(console, table)
    else:
        print_text(console, "Software, processor and plugins are the same as in the run.")
    if not result.is_equal:
        raise typer.Exit(DIFFERENT)
