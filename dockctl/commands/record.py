"""``dockctl record``: trajectories of a policy, for ``dockctl plot``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import (
    Ckpt,
    Plugins,
    PolicyArgument,
    Poses,
    ScenarioOption,
    Trust,
    parse_pose,
    select_policy,
)


def record(
    policy: PolicyArgument = None,
    ckpt: Ckpt = None,
    scenario: ScenarioOption = None,
    plugin: Plugins = None,
    trust: Trust = False,
    pose: Poses = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the recording; transfer/<scenario> in the run folder by default."),
    ] = None,
) -> None:
    """Run greedy episodes and record every step; dockctl plot draws the folder like a run.

    Example: dockctl record --ckpt runs/s3/20250101-120000-seed0 --scenario s3-opposite
    """
    from dockctl.analysis.episodes import ending
    from dockctl.evaluation.record import FILES
    from dockctl.evaluation.record import record as run
    from dockctl.runs.directory import FIGURES, RECORDING, TRANSFER
    from dockctl.runs.files import require_replaceable
    from dockctl.runs.results import require_same_policy

    poses = [parse_pose(text) for text in pose or ()]
    given = select_policy(policy, ckpt, plugin, trust, scenario)
    name = given.scenario(scenario).scenario.name
    if given.results and not out:
        folder = given.results / TRANSFER / name
    else:
        folder = out or Path(TRANSFER) / f"{name}-{given.file_name}"
        require_same_policy(folder / RECORDING, given.facts())
    require_replaceable(folder, FILES, (FIGURES, RECORDING), "earlier recording")
    result = run(given, scenario, poses)
    result.write(folder)
    for episode in result.episodes:
        x, y, heading = episode.start.eta
        typer.echo(f"from {x:g}, {y:g}, {math.degrees(heading):.4g}°: {ending(episode.row())}")
    typer.echo(folder)
