"""``dockctl ship``: export a policy as a folder that can be passed on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Plugins, Trust

CHECKPOINTS = Path("checkpoints")


def ship(
    runs: Annotated[list[Path], typer.Argument(help="Evaluated run folders of one scenario.")],
    name: Annotated[str | None, typer.Option(help="Name of the checkpoint; the scenario by default.")] = None,
    plugin: Plugins = None,
    trust: Trust = False,
    out: Annotated[Path, typer.Option(help="Folder of the checkpoint: <out>/<name>/.")] = CHECKPOINTS,
) -> None:
    """Export the best policy of one or more runs, with its scenario and a model card.

    The best policy docks from the most evaluation poses, or at the most trained berths; then from the most
    random starts, or at the most held-out berths; then most often on the other scenarios it was evaluated on;
    then it has the lowest seed. It must dock from all its training poses, unless its scenario has many
    berths. The card includes the results of `evaluate`, `map` and `latency`.

    Example: dockctl ship runs/s3/* --name s3
    """
    from dockctl.experiments import export

    export.ship(runs, name, out, plugin_files=plugin or (), trust=trust)
