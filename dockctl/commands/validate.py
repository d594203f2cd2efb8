"""``dockctl validate``: check scenario files and print all problems."""

from __future__ import annotations

from typing import Annotated

import typer

from dockctl.commands.options import Overrides, Plugins, Trust
from dockctl.errors import DockctlError


def validate(
    files: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCENARIO", help="Scenario files or names; all registered scenarios by default."
        ),
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
    from dockctl.experiments.registered import phases, summary
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
