"""``dockctl train``: train a policy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dockctl.commands.options import DEFAULT_SCENARIO, Overrides, Plugins, Trust
from dockctl.errors import DockctlError
from dockctl.experiments.interrupt import INTERRUPTED
from dockctl.runs.directory import RUNS, RunDirectory


def train(
    scenario: Annotated[
        str | None, typer.Argument(help=f"Scenario file or name; {DEFAULT_SCENARIO} by default.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Random seed.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Output folder, for <scenario>/<time>-seed<N>/.", show_default=str(RUNS)),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="[RUN]",
            help="Continue a run after an interruption, or extend it to --steps; without RUN, the latest run"
            " in ./runs that is not finished.",
        ),
    ] = None,
    set_: Overrides = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Limit of environment steps, all boats together.")
    ] = None,
    on_divergence: Annotated[
        str | None,
        typer.Option(metavar="stop|rollback|continue", help="When the training diverges; stop by default."),
    ] = None,
    device: Annotated[str, typer.Option(help="Torch device of the networks: cpu, cuda, ...")] = "cpu",
    plugin: Plugins = None,
    trust: Trust = False,
) -> None:
    """Train a policy, and write checkpoints, tables and trajectories to a run folder.

    Example: dockctl train s3 --seed 1 --set training.boats=8
    """
    from dockctl import experiments

    if resume is None:
        run = experiments.train(
            DEFAULT_SCENARIO if scenario is None else scenario,
            seed=seed,
            steps=steps,
            on_divergence=on_divergence,
            overrides=set_ or (),
            plugin_files=plugin or (),
            out=RUNS if out is None else out,
            device=device,
            trust=trust,
        )
    else:
        given = {"SCENARIO": scenario, "--seed": seed, "--out": out, "--set": set_, "--plugin": plugin}
        if extra := [name for name, value in given.items() if value not in (None, [])]:
            raise DockctlError(f"--resume continues the run with its own settings: omit {', '.join(extra)}")
        path = Path(resume) if resume else RunDirectory.latest_interrupted(RUNS).path
        run = experiments.resume(path, steps=steps, on_divergence=on_divergence, device=device, trust=trust)
    if run.reason == "interrupted":
        raise typer.Exit(INTERRUPTED)
