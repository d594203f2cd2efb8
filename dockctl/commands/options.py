"""Options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Ckpt = Annotated[
    Path | None, typer.Option(help="Run folder or checkpoint; the latest run in ./runs if none is given.")
]
"""The policy that a command measures."""

Elsewhere = Annotated[
    str | None,
    typer.Option(help="Scenario to dock in, file or name; the one of the training by default."),
]
"""Where it is measured."""
