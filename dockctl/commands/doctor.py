"""``dockctl doctor``: describe the installation for a bug report."""

from __future__ import annotations

import typer

from dockctl.commands.options import Json


def doctor(json_: Json = None) -> None:
    """Print versions, machine, folders and extras as Markdown for a bug report, with the problems found.

    Example: dockctl doctor --json -
    """
    from dockctl.experiments.doctor import examine

    report = examine()
    if json_:
        json_.write(report.to_json())
    else:
        typer.echo(report.markdown(), nl=False)
