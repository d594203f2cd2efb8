"""``dockctl ship``: make a policy a folder that can be handed on."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

CHECKPOINTS = Path("checkpoints")


def ship(
    runs: Annotated[
        list[Path], typer.Argument(help="Run folders of one scenario, evaluated; the best is taken.")
    ],
    name: Annotated[
        str | None, typer.Option(help="Of the checkpoint; that of the scenario by default.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder that gets <name>/.")] = CHECKPOINTS,
) -> None:
    """Put the best policy of one or more runs into a folder of its own, with scenario and model card.

    Of several runs the one is taken that docks from the most test poses, or at the most trained berths; then
    from the most random starts, or at the most held-out berths; then most often on the other scenarios that
    it was evaluated on; then that of the lowest seed. It must dock from every pose of its training, unless
    that has many berths. What `evaluate`, `map` and `latency` found goes into the card.

    Example: dockctl ship runs/s3/* --name s3
    """
    from dockctl.experiments import export as shipping

    shipping.ship(runs, name, out)
