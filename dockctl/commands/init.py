"""``dockctl init``: write a commented template."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import print_paths

KINDS = ("scenario", "reward", "observation", "vessel", "harbor", "policy", "plugin")


def init(
    kind: Annotated[
        str, typer.Argument(metavar="|".join(KINDS), help="What to add.", autocompletion=lambda: [*KINDS])
    ],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Its name; the files are named after it.")],
    out: Annotated[Path, typer.Option(help="Output folder.")] = Path(),
) -> None:
    """Write a commented template that runs as it is, and print the commands to try next.

    A plugin is a package that others can install; the other kinds are files for your own use. Existing files
    are never overwritten.

    Example: dockctl init reward calm
    """
    from dockctl.experiments.scaffold import write_starter

    written, following = write_starter(kind, name, out)
    print_paths(written)
    typer.echo("Next:")
    for line in following:
        typer.echo(f"  {line}")
