"""``dockctl list``: what is registered, and who brings it."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dockctl.errors import DockctlError

if TYPE_CHECKING:
    from dockctl.plugins import Entry

COLUMNS = ("name", "kind", "source", "parameters", "origin")


class Sort(StrEnum):
    """What can be listed."""

    rewards = "rewards"
    observations = "observations"
    scenarios = "scenarios"
    vessels = "vessels"
    harbors = "harbors"
    checkpoints = "checkpoints"


def list_registered(
    sort: Annotated[Sort, typer.Argument(help="What to list.", metavar="|".join(Sort))] = Sort.scenarios,
    plugin: Annotated[list[Path] | None, typer.Option(help="Local .py file to load first.")] = None,
) -> None:
    """List reward terms, observation parts, scenarios, vessels, harbors or shipped checkpoints.

    Example: dockctl list rewards --plugin my_terms.py
    """
    from dockctl import plugins
    from dockctl.scenarios import catalog

    if sort is Sort.checkpoints:
        _print(sort.value, list(_checkpoints()))
        return
    catalog.fill()
    failures = []
    for path in plugin or ():
        try:
            plugins.load_file(path)
        except DockctlError as error:
            failures.append(str(error))
    registry = plugins.GROUPS[f"dockctl.{sort.value}"]
    rows: list[tuple[str, ...]] = []
    for name in sorted(registry.names()):
        origin = registry.origin(name)
        try:
            rows.append((name, *_describe(registry.get(name), sort), origin))
        except DockctlError as error:
            rows.append((name, "broken", "", str(error), origin))
    _print(sort.value, rows)
    if failures:
        raise DockctlError("\n".join(failures))


def _checkpoints() -> Iterator[tuple[str, ...]]:
    from dockctl.runs.directory import SCENARIO, RunDirectory, shipped
    from dockctl.scenarios import loader

    for name, folder in shipped().items():
        facts = RunDirectory(folder).read_json("policy.json")
        told = f"seed {facts.get('seed')}, {facts.get('env_steps'):,} steps"
        size = f"{facts.get('observation_size')} numbers to {facts.get('actions')} actions"
        yield name, "policy", loader.load(folder / SCENARIO).scenario.title, f"{told}, {size}", "dockctl"


def _describe(entry: Entry[Any], sort: Sort) -> tuple[str, str, str]:
    """Return kind, source and parameters."""
    if sort in (Sort.rewards, Sort.observations):
        parameters = [
            name if default is inspect.Parameter.empty else f"{name}={default}"
            for name, default in entry.parameters.items()
        ]
        return entry.kind, entry.source, ", ".join(parameters)
    return _describe_file(entry.value, sort)


def _describe_file(path: Path, sort: Sort) -> tuple[str, str, str]:
    from dockctl.commands.validate import phases, summary
    from dockctl.scenarios import catalog, loader

    if sort is Sort.scenarios:
        scenario = loader.load(path).scenario
        return phases(scenario), scenario.title, summary(scenario)
    if sort is Sort.vessels:
        vessel = loader.load_vessel(path)
        size = f"{vessel.hull.length_m:g} x {vessel.hull.beam_m:g} m, {vessel.mass_kg:g} kg"
        return "3-DOF", catalog.display_path(path), size
    harbor = loader.load_harbor(path)
    return harbor.kind, catalog.display_path(path), harbor.name


def _print(title: str, rows: list[tuple[str, ...]]) -> None:
    """Draw a table in a terminal; columns divided by tabs elsewhere."""
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
