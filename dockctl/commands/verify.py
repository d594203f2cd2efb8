"""``dockctl verify``: does a training repeat on this machine?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from dockctl.commands.options import Plugins, Trust
from dockctl.console import make_table, numeric, print_text, table_console

DIFFERENT = 1


def verify(
    run: Annotated[Path, typer.Argument(help="Run folder.")],
    steps: Annotated[
        int, typer.Option(min=1, help="Environment steps to repeat, all boats together.")
    ] = 10_000,
    plugin: Plugins = None,
    trust: Trust = False,
) -> None:
    """Repeat the first steps of a training in a temporary folder, and compare its tables with the run's.

    Prints what differs between the machine of the run and this one: software, processor, plugins. Exits with
    0 if all rows are equal, and with 1 if one differs. A seed gives the same rows on the same machine; on
    another one rounding may differ.

    Example: dockctl verify runs/s3/20250101-120000-seed0
    """
    from dockctl.experiments.verify import verify as repeat

    with Console(stderr=True).status("repeating the training"):
        result = repeat(run, steps, plugin_files=plugin or (), trust=trust)
    console = table_console()
    table = make_table("table", *numeric("rows", "SHA-256"), "", title=f"The first {result.steps:,} steps")
    for check in result.tables:
        verdict = f"[red]{check.difference}[/]" if check.difference else "[green]equal[/]"
        table.add_row(check.name, f"{check.rows:,}", check.here[:16], verdict)
    console.print(table)
    if result.conditions:
        table = make_table("differs here", "in the run", "here")
        for row in result.conditions:
            table.add_row(*row)
        console.print(table)
    else:
        print_text(console, "Software, processor and plugins are those of the run.")
    if not result.is_equal:
        raise typer.Exit(DIFFERENT)
