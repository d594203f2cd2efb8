"""``dockctl evaluate``: how well does a policy dock?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import Ckpt, Elsewhere, finite

BELOW_MINIMUM = 1


def evaluate(
    ckpt: Ckpt = None,
    scenario: Elsewhere = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scenario.")
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(min=0, max=100_000, help="Random starts; as many as the scenario says by default."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the random starts.")] = None,
    min_success: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1,
            callback=finite,
            help="Exit with 1 when fewer dock, of the test poses or of the random starts.",
        ),
    ] = None,
    json_: Annotated[Path | None, typer.Option("--json", help="Write the result here.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write one row an episode here.")] = None,
) -> None:
    """Play greedy episodes from the scenario's test poses and from random starts around the initial poses.

    The result is stored in the run folder too, when the policy lies in one; one of another scenario, or with
    values set, under a name of its own.

    Example: dockctl evaluate --ckpt runs/s3/20250101-120000-seed0 --episodes 200 --min-success 0.9
    """
    from dockctl.evaluation import evaluate as evaluation

    outputs = [path for path in (json_, csv) if path]
    result = evaluation.measure(ckpt, scenario, episodes, seed, outputs, set_ or [])
    evaluation.store(result, json_, csv)
    evaluation.show(result)
    if min_success is not None and result.least_success < min_success:
        typer.secho(
            f"success {result.least_success:.0%} is below the asked {min_success:.0%}", fg="red", err=True
        )
        raise typer.Exit(BELOW_MINIMUM)
