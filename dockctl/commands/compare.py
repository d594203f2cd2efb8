"""``dockctl compare``: which of these policies docks better?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FIGURES = Path("figures") / "compare"


def compare(
    policies: Annotated[
        list[Path],
        typer.Argument(help="Two or more run folders, checkpoints or names of shipped checkpoints."),
    ],
    scenario: Annotated[
        str | None,
        typer.Option(help="Scenario to dock in, file or name; that of the first policy by default."),
    ] = None,
    episodes: Annotated[
        int | None,
        typer.Option(min=0, max=100_000, help="Random starts; as many as the scenario says by default."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the random starts.")] = None,
    json_: Annotated[Path | None, typer.Option("--json", help="Write the comparison here.")] = None,
    csv: Annotated[Path | None, typer.Option(help="Write one row an episode here.")] = None,
    out: Annotated[Path, typer.Option(help="Folder of the figure.")] = FIGURES,
) -> None:
    """Let policies dock from the same starts, and tell how far each differs from the first.

    Success has Wilson intervals and its differences Newcombe's for pairs; time, path, clearance and control
    changes are compared over the episodes that both dock, with bootstrap intervals. All hold for 95 %.

    Example: dockctl compare s1 s2 runs/s2/20250101-120000-seed1 --scenario s2 --episodes 200
    """
    from dockctl.evaluation import compare as comparison

    comparison.compare(policies, scenario, episodes, seed, json_, csv, out)
