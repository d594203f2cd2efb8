"""``dockctl validate``: check scenario files and print all problems."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from dockctl.commands.options import Overrides, Plugins, Trust
from dockctl.console import count
from dockctl.errors import DockctlError

if TYPE_CHECKING:
    from dockctl.scenarios.schema import Scenario


def validate(
    files: Annotated[
        list[str] | None,
        typer.Argument(help="Scenario files or names [default: all registered scenarios]."),
    ] = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
) -> None:
    """Check scenario files, that their poses are free of obstacles, and that their plugins work.

    Example: dockctl validate scenarios/s3.yaml --set task.max_steps=600
    """
    from dockctl import plugins
    from dockctl.experiments.dry_run import dry_run
    from dockctl.plugins import SCENARIOS
    from dockctl.scenarios import catalog
    from dockctl.sim.world import load_checked, notes

    catalog.fill()
    for path in plugin or ():
        plugins.load_file(path)
    failures = 0
    for source in files or sorted(SCENARIOS.names()):
        try:
            loaded = load_checked(source, overrides=set_ or (), plugin_files=plugin or (), trust=trust)
            dry_run(loaded)
        except DockctlError as error:
            failures += 1
            typer.echo(f"{typer.style('failed', fg='red')} {source}")
            for line in str(error).splitlines():
                typer.secho(f"error: {line}", fg="red", err=True)
        else:
            content = f"{phases(loaded.scenario)}, {summary(loaded.scenario)}"
            typer.echo(f"{typer.style('ok', fg='green')} {source}: {content}")
            for note in notes(loaded):
                typer.secho(f"note: {note}", fg="yellow", err=True)
    if failures:
        raise typer.Exit(DockctlError.exit_code)


def phases(scenario: Scenario) -> str:
    """Return the number of phases in words: two with an intermediate pose."""
    return "two phases" if scenario.task.intermediate else "one phase"


def summary(scenario: Scenario) -> str:
    """Return a one-line summary of a scenario."""
    starts = count(len(scenario.task.initial), "start")
    parts = count(len(scenario.observation), "observation part")
    terms = count(len(scenario.reward.terms), "reward term")
    where = f"{scenario.vessel.name} in {scenario.harbor.name}"
    return f"{starts}, {parts}, {terms}; {where}, {count(scenario.training.boats, 'boat')} in training"
