"""``dockctl train``: teach a boat to dock."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import DEFAULT_SCENARIO
from dockctl.errors import DockctlError
from dockctl.experiments.interrupt import INTERRUPTED
from dockctl.runs.directory import RUNS


def train(
    scenario: Annotated[
        str | None, typer.Argument(help=f"Scenario file or name; {DEFAULT_SCENARIO} if none is given.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of everything random.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder that gets <scenario>/<time>-seed<N>/.", show_default=str(RUNS)),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(help="Run folder to take up where it was interrupted, or to extend by --steps."),
    ] = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the scenario.")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Environment steps at most, all boats together.")
    ] = None,
    device: Annotated[str, typer.Option(help="Of the network: cpu, cuda, ...")] = "cpu",
    plugin: Annotated[
        list[Path] | None, typer.Option(help="Local .py file with reward terms or parts.")
    ] = None,
) -> None:
    """Train a policy; the run folder gets its checkpoints, tables and trajectories.

    Example: dockctl train scenarios/s3.yaml --seed 1 --set training.boats=8
    """
    from dockctl.agents.device import device_named
    from dockctl.experiments import training

    device_named(device)
    if resume is None:
        overrides = [*(set_ or ())]
        overrides += [] if seed is None else [f"training.seed={seed}"]
        overrides += [] if steps is None else [f"training.total_steps={steps}"]
        source = DEFAULT_SCENARIO if scenario is None else scenario
        ready = training.begin(source, overrides, plugin or [], RUNS if out is None else out)
    else:
        given = {"SCENARIO": scenario, "--seed": seed, "--out": out, "--set": set_, "--plugin": plugin}
        if refused := [name for name, value in given.items() if value not in (None, [])]:
            raise DockctlError(
                f"{', '.join(refused)}: a run that is taken up keeps its own; leave it out with --resume"
            )
        ready = training.take_up(resume, steps)
    with ready as session:
        ending = training.carry_out(session, device)
    if ending == "interrupted":
        raise typer.Exit(INTERRUPTED)
