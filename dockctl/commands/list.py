"""``dockctl list``: print what is registered, and by whom."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Annotated

import typer
from rich.console import Console

from dockctl import plugins
from dockctl.commands.options import Json, Plugins
from dockctl.console import make_table, print_table
from dockctl.errors import DockctlError, nearest
from dockctl.experiments.registered import COLUMNS, LISTINGS, Row, rows_of


def list_registered(
    listing: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND",
            help=f"What to list: {', '.join(LISTINGS)}; everything by default.",
            autocompletion=lambda: [*LISTINGS],
        ),
    ] = None,
    plugin: Plugins = None,
    json_: Json = None,
) -> None:
    """List what is registered, with description, parameters and provider, and the named checkpoints.

    Example: dockctl list rewards
    """
    from dockctl.scenarios import catalog

    if listing is not None and listing not in LISTINGS:
        message = f"'{listing}' cannot be listed (known: {', '.join(LISTINGS)})"
        raise DockctlError(message, code="unknown_name", suggestion=nearest(listing, LISTINGS))
    catalog.fill()
    for path in plugin or ():
        plugins.load_file(path)
    found = {name: rows_of(name) for name in (LISTINGS if listing is None else (listing,))}
    if json_:
        rows = ((name, *row) for name, rows in found.items() for row in rows)
        json_.write([dict(zip(COLUMNS, row, strict=True)) for row in rows])
    else:
        _print(found)


def _print(found: Mapping[str, Sequence[Row]]) -> None:
    """Print tables to a terminal, else tab-separated columns."""
    if not sys.stdout.isatty():
        for row in (COLUMNS, *((listing, *row) for listing, rows in found.items() for row in rows)):
            typer.echo("\t".join(row))
        return
    from rich.table import Column
    from rich.text import Text

    for listing, rows in found.items():
        filled = [i for i in range(len(COLUMNS) - 1) if any(row[i] for row in rows)]
        columns = [Column(COLUMNS[i + 1], overflow="fold", no_wrap=i == 0) for i in filled]
        table = make_table(*columns, title=listing)
        for row in rows:
            style = "red" if row[1] == "broken" else ""
            table.add_row(*(Text(row[i], style=style) for i in filled))
        print_table(Console(), table)
