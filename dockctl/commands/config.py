"""``dockctl config``: the resolved scenario and the origin of its values."""

from __future__ import annotations

from typing import Annotated

import typer

from dockctl.commands.options import Json, Overrides, Plugins, Trust


def config(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="Scenario file or name.")],
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    json_: Json = None,
) -> None:
    """Print the resolved scenario as YAML, with the file and line that each value comes from.

    Values that no file sets are marked as default, or with the preset that they come from.

    Example: dockctl config s3 --set training.seed=4
    """
    from dockctl.scenarios.loader import load
    from dockctl.scenarios.settings import settings, to_yaml

    loaded = load(scenario, overrides=set_ or (), plugin_files=plugin or (), trust=trust)
    listed = settings(loaded)
    if json_:
        json_.write([setting.to_json() for setting in listed])
    else:
        typer.echo(to_yaml(listed), nl=False)
