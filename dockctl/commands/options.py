"""Options that several commands share."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dockctl.errors import DockctlError

if TYPE_CHECKING:
    from dockctl.scenarios.base import Pose

RUNS = Path("runs")
"""Folder that trainings go to, and are looked for in, by default."""

DEFAULT_SCENARIO = "s3"
LARGEST_COORDINATE = 10_000
"""Limit of a pose's numbers [m] or [°], far beyond any harbor."""


def finite(value: float | None) -> float | None:
    """Refuse what is no number; the ranges of some versions of Click let it through.

    Raises:
        typer.BadParameter: it is not finite.
    """
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number")
    return value


def parse_pose(text: str) -> Pose:
    """Parse the value of ``--pose``: x [m], y [m] and heading [°], separated by commas.

    Raises:
        DockctlError: it is something else.
    """
    from dockctl.scenarios.base import Pose

    try:
        x, y, heading = (float(part) for part in text.split(","))
    except ValueError:
        raise DockctlError(
            f"--pose '{text}': expected three numbers, x,y,heading in m, m and degrees, for example 20,2,160",
            code="wrong_type",
        ) from None
    if not all(abs(number) <= LARGEST_COORDINATE for number in (x, y, heading)):
        raise DockctlError(
            f"--pose '{text}': expected numbers within ±{LARGEST_COORDINATE:,}", code="out_of_range"
        )
    return Pose(x_m=x, y_m=y, heading_deg=heading)


Ckpt = Annotated[
    Path | None, typer.Option(help="Run folder or checkpoint; the latest run in ./runs if none is given.")
]
"""The policy that a command measures."""

Elsewhere = Annotated[
    str | None,
    typer.Option(help="Scenario to dock in, file or name; the one of the training by default."),
]
"""Where it is measured."""
