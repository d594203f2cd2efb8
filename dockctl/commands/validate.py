"""``dockctl validate``: check scenario files and print all problems."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.console import Console

from dockctl.commands.options import Overrides, Plugins, Trust
from dockctl.console import print_notes, print_text
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

    Example: dockctl validate s3 --set task.max_steps=600
    """
    from dockctl import plugins
    from dockctl.experiments.dry_run import dry_run
    from dockctl.experiments.registered import phases, summary
    from dockctl.plugins import SCENARIOS
    from dockctl.scenarios import catalog
    from dockctl.sim.checks import load_checked, notes

    catalog.fill()
    for path in plugin or ():
        plugins.load_file(path)
    console, problems, failures = Console(), Console(stderr=True), 0
    for source in files or sorted(SCENARIOS.names()):
        try:
            loaded = load_checked(source, overrides=set_ or (), plugin_files=plugin or (), trust=trust)
            dry_run(loaded)
        except DockctlError as error:
            failures += 1
            print_text(console, f"failed {source}", "red")
            for line in str(error).splitlines():
                print_text(problems, f"error: {line}", "red")
        else:
            content = f"{phases(loaded.scenario)}, {summary(loaded.scenario)}"
            print_text(console, f"ok {source}: {content}")
            print_notes(notes(loaded))
    if failures:
        raise typer.Exit(DockctlError.exit_code)
