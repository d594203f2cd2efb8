"""``dockctl list``: print what is registered, and by whom."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dockctl import plugins
from dockctl.commands.options import Plugins
from dockctl.errors import DockctlError, nearest

if TYPE_CHECKING:
    from dockctl.plugins import Entry

COLUMNS = ("name", "kind", "source", "parameters", "origin")


CHECKPOINTS = "checkpoints"
LISTINGS = (*(group.removeprefix("dockctl.") for group in (*plugins.DATA, *plugins.CODE)), CHECKPOINTS)


def list_registered(
    listing: Annotated[
        str,
        typer.Argument(
            help="Registry to list.", metavar="|".join(LISTINGS), autocompletion=lambda: [*LISTINGS]
        ),
    ] = "scenarios",
    plugin: Plugins = None,
) -> None:
    """List what is registered, with its parameters and who provides it, or the shipped checkpoints.

    Example: dockctl list rewards --plugin examples/local-term/gentle.py
    """
    from dockctl.scenarios import catalog

    if listing not in LISTINGS:
        message = f"'{listing}' cannot be listed (known: {', '.join(LISTINGS)})"
        raise DockctlError(message, code="unknown_name", suggestion=nearest(listing, LISTINGS))
    if listing == CHECKPOINTS:
        _print(listing, list(_checkpoints()))
        return
    catalog.fill()
    for path in plugin or ():
        plugins.load_file(path)
    group = f"dockctl.{listing}"
    registry = plugins.GROUPS[group]
    rows: list[tuple[str, ...]] = []
    for name in sorted(registry.names()):
        origin = registry.origin(name)
        try:
            entry = registry.get(name)
            described = _describe_file(entry.value, listing) if group in plugins.DATA else _describe(entry)
            rows.append((name, *described, origin))
        except DockctlError as error:
            rows.append((name, "broken", "", str(error), origin))
    _print(listing, rows)


def _checkpoints() -> Iterator[tuple[str, ...]]:
    from dockctl.runs.directory import SCENARIO, RunDirectory, shipped
    from dockctl.scenarios import loader

    for name, folder in shipped().items():
        facts = RunDirectory(folder).read_json("policy.json")
        training = f"seed {facts.get('seed')}, {facts.get('env_steps'):,} steps"
        size = f"{facts.get('observation_size')} numbers to {facts.get('actions')} actions"
        yield name, "policy", loader.load(folder / SCENARIO).scenario.title, f"{training}, {size}", "dockctl"


def _describe(entry: Entry[Any]) -> tuple[str, str, str]:
    """Return kind, source and parameters of a function or a model."""
    parameters = [
        name if default is inspect.Parameter.empty else f"{name}={_short(default)}"
        for name, default in entry.parameters.items()
        if name != "kind"
    ]
    return entry.kind, entry.source, ", ".join(parameters)


def _short(default: Any) -> str:
    text = str(default)
    return f"({len(default)} values)" if isinstance(default, tuple) and len(text) > 40 else text


def _describe_file(path: Path, listing: str) -> tuple[str, str, str]:
    from dockctl.commands.validate import phases, summary
    from dockctl.scenarios import catalog, loader

    if listing == "scenarios":
        scenario = loader.load(path).scenario
        return phases(scenario), scenario.title, summary(scenario)
    if listing == "vessels":
        vessel = loader.load_vessel(path)
        size = f"{vessel.hull.length_m:g} x {vessel.hull.beam_m:g} m, {vessel.mass_kg:g} kg"
        return "3-DOF", catalog.display_path(path), size
    harbor = loader.load_harbor(path)
    return harbor.kind, catalog.display_path(path), harbor.name


def _print(title: str, rows: list[tuple[str, ...]]) -> None:
    """Print a table to a terminal, else tab-separated columns."""
    if not sys.stdout.isatty():
        for row in (COLUMNS, *rows):
            typer.echo("\t".join(row))
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=title, header_style="bold")
    for column in COLUMNS:
        table.add_column(column, overflow="fold")
    for row in rows:
        style = "red" if row[1] == "broken" else ""
        table.add_row(*(Text(cell, style=style) for cell in row))
    Console().print(table)
