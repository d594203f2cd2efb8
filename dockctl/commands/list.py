"""``dockctl list``: print what is registered, and by whom."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from dockctl import plugins
from dockctl.commands.options import Json, Plugins
from dockctl.console import make_table, print_table
from dockctl.errors import DockctlError, nearest

if TYPE_CHECKING:
    from dockctl.plugins import Entry

COLUMNS = ("listing", "name", "kind", "description", "parameters", "source", "origin")

CHECKPOINTS = "checkpoints"
LISTINGS = (*(group.removeprefix("dockctl.") for group in (*plugins.DATA, *plugins.CODE)), CHECKPOINTS)

Row = tuple[str, ...]
"""Columns `COLUMNS` after the first."""


def list_registered(
    listing: Annotated[
        str | None,
        typer.Argument(
            help="What to list; everything by default.",
            metavar="|".join(LISTINGS),
            autocompletion=lambda: [*LISTINGS],
        ),
    ] = None,
    plugin: Plugins = None,
    json_: Json = None,
) -> None:
    """List what is registered, with description, parameters and who provides it, and the named checkpoints.

    Example: dockctl list rewards --plugin examples/local-term/gentle.py
    """
    from dockctl.scenarios import catalog

    if listing is not None and listing not in LISTINGS:
        message = f"'{listing}' cannot be listed (known: {', '.join(LISTINGS)})"
        raise DockctlError(message, code="unknown_name", suggestion=nearest(listing, LISTINGS))
    catalog.fill()
    for path in plugin or ():
        plugins.load_file(path)
    names = LISTINGS if listing is None else (listing,)
    found = {name: list(_checkpoints() if name == CHECKPOINTS else _registered(name)) for name in names}
    if json_:
        rows = ((name, *row) for name, rows in found.items() for row in rows)
        json_.write([dict(zip(COLUMNS, row, strict=True)) for row in rows])
    else:
        _print(found)


def _registered(listing: str) -> Iterator[Row]:
    group = f"dockctl.{listing}"
    registry = plugins.GROUPS[group]
    for name in sorted(registry.names()):
        origin = registry.origin(name)
        try:
            entry = registry.get(name)
            described = _describe_file(entry.value, listing) if group in plugins.DATA else _describe(entry)
            yield name, *described, origin
        except DockctlError as error:
            yield name, "broken", str(error), "", "", origin


def _checkpoints() -> Iterator[Row]:
    from dockctl.runs.directory import POLICY_JSON, SCENARIO, RunDirectory, named_checkpoints, shipped
    from dockctl.scenarios import loader

    for name, folder in named_checkpoints().items():
        facts = RunDirectory(folder).read_json(POLICY_JSON)
        training = f"seed {facts.get('seed')}, {facts.get('env_steps'):,} steps"
        size = f"{facts.get('observation_size')} numbers to {facts.get('actions')} actions"
        origin = "dockctl" if name in shipped() else f"folder {folder}"
        try:
            title = loader.load(folder / SCENARIO).scenario.title
        except DockctlError as error:  # for example because it has plugins that may not run
            title = str(error).splitlines()[0]
        yield name, "policy", title, f"{training}, {size}", "", origin


def _describe(entry: Entry[Any]) -> tuple[str, str, str, str]:
    """Return kind, description, parameters and source of a function or a model."""
    parameters = [
        name if default is inspect.Parameter.empty else f"{name}={_short(default)}"
        for name, default in entry.parameters.items()
        if name != "kind"
    ]
    documentation = inspect.getdoc(entry.value) or ""
    return entry.kind, documentation.partition("\n")[0], ", ".join(parameters), entry.source


def _short(default: Any) -> str:
    text = str(default)
    return f"({len(default)} values)" if isinstance(default, tuple) and len(text) > 40 else text


def _describe_file(path: Path, listing: str) -> tuple[str, str, str, str]:
    from dockctl.commands.validate import phases, summary
    from dockctl.scenarios import catalog, loader

    shown = catalog.display_path(path)
    if listing == "scenarios":
        scenario = loader.load(path).scenario
        return phases(scenario), scenario.title, summary(scenario), shown
    if listing == "vessels":
        vessel = loader.load_vessel(path)
        size = f"{vessel.hull.length_m:g} x {vessel.hull.beam_m:g} m, {vessel.mass_kg:g} kg"
        return "3-DOF", size, "", shown
    harbor = loader.load_harbor(path)
    return harbor.kind, harbor.name, "", shown


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
