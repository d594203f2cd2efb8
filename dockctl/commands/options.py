"""Options that several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

RUNS = Path("runs")
"""Folder that trainings go to, and are looked for in, by default."""

DEFAULT_SCENARIO = "s3"


def finite(value: float | None) -> float | None:
    """Refuse what is no number; the ranges of some versions of Click let it through.

    Raises:
        typer.BadParameter: it is not finite.
    """
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number")
    return value


Ckpt = Annotated[
    Path | None, typer.Option(help="Run folder or checkpoint; the latest run in ./runs if none is given.")
]
"""The policy that a command measures."""

Elsewhere = Annotated[
    str | None,
    typer.Option(help="Scenario to dock in, file or name; the one of the training by default."),
]
"""Where it is measured."""
