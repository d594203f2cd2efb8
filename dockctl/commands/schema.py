"""``dockctl schema``: JSON Schema of the YAML files, for editors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Plugins, print_paths
from dockctl.errors import DockctlError, nearest

FILES = ("scenario", "vessel", "harbor", "study")


def schema(
    file: Annotated[
        str, typer.Argument(metavar="|".join(FILES), help="Type of file.", autocompletion=lambda: [*FILES])
    ] = FILES[0],
    plugin: Plugins = None,
    out: Annotated[Path | None, typer.Option(help="Write to this file instead of standard output.")] = None,
) -> None:
    """Print a JSON Schema that lets editors complete and check scenario files.

    It includes all registered rewards, observations, actions and so on; --plugin adds those of a local file.

    Example: dockctl schema --out dockctl-scenario.json
    """
    from dockctl import plugins
    from dockctl.runs.files import json_text, require_writable_file, write_atomically
    from dockctl.scenarios import catalog, json_schema

    if file not in FILES:
        message = f"there is no schema for '{file}' files (known: {', '.join(FILES)})"
        raise DockctlError(message, code="unknown_name", suggestion=nearest(file, FILES))
    if out:
        require_writable_file(out, ".json")
    catalog.fill()
    for path in plugin or ():
        plugins.load_file(path)
    if file == "study":
        from dockctl.experiments.study import Study

        text = json_text(json_schema.model_schema(Study))
    else:
        text = json_text(getattr(json_schema, f"{file}_schema")())
    if out:
        print_paths([write_atomically(out, text.encode())])
    else:
        typer.echo(text, nl=False)
