"""``dockctl train``: train a policy."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from dockctl.commands.options import Json, Plugins, Trust
from dockctl.errors import DockctlError
from dockctl.experiments.interrupt import INTERRUPTED
from dockctl.run_files import RUNS
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.catalog import DEFAULT_SCENARIO

SWEEPS = RUNS / "sweep"
FAILED = 1


def train(
    scenario: Annotated[
        str | None,
        typer.Argument(metavar="SCENARIO", help=f"Scenario file or name; {DEFAULT_SCENARIO} by default."),
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Random seed.")] = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, max=1000, help="Train with the seeds 0 to N-1, and compare.", metavar="N"),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, max=1024, help="Number of runs in parallel.", show_default="cores"),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Output folder; below it are folders for the scenario, for each combination of a sweep, and"
            " for each run.",
            show_default=f"{RUNS}, or {SWEEPS}",
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="[RUN]",
            help="Continue a run after an interruption, or extend it to --steps; without RUN, the latest run"
            " in ./runs that is not finished.",
        ),
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE[,VALUE…]",
            help="Override a value of the scenario; several values train every combination. Commas in"
            " brackets or quotes do not separate values.",
        ),
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Maximum number of environment steps, summed over all boats.")
    ] = None,
    from_: Annotated[
        str | None,
        typer.Option(
            "--from",
            metavar="POLICY",
            help="Fine-tune a trained policy: run folder, checkpoint, or the name of a shipped policy.",
        ),
    ] = None,
    on_divergence: Annotated[
        Literal["stop", "rollback", "continue"] | None,
        typer.Option(help="What to do if training diverges; stop by default."),
    ] = None,
    log: Annotated[
        list[str] | None,
        typer.Option(
            metavar="tensorboard|wandb", help="Also log the tables to this service; can be repeated."
        ),
    ] = None,
    device: Annotated[str, typer.Option(help="Torch device of the networks: cpu, cuda, ...")] = "cpu",
    sim_device: Annotated[
        str,
        typer.Option(
            metavar="cpu|cuda",
            help="Device of the simulation: cpu, or cuda for an NVIDIA GPU with dockctl[gpu], which is faster"
            " with hundreds of boats.",
        ),
    ] = "cpu",
    plugin: Plugins = None,
    trust: Trust = False,
    json_: Json = None,
    name: Annotated[str | None, typer.Option(help="Name of the run, for its provenance.")] = None,
    tag: Annotated[list[str] | None, typer.Option(help="Tag of the run; can be repeated.")] = None,
) -> None:
    """Train a policy, and write checkpoints, tables and trajectories to a run folder.

    With --seeds, or several values after --set, train and evaluate every combination, and print a summary;
    the same command resumes it.

    Example: dockctl train s3 --seed 1 --set training.boats=8
    """
    from dockctl import experiments
    from dockctl.experiments.sweep import is_sweep, sweep

    start = {
        "SCENARIO": scenario, "--seed": seed, "--seeds": seeds, "--jobs": jobs, "--out": out, "--set": set_,
        "--from": from_, "--plugin": plugin, "--name": name, "--tag": tag,
    }  # fmt: skip
    several = is_sweep(set_ or (), seeds)
    if json_ and not several:
        raise DockctlError("--json: only a sweep has a summary; give --seeds, or several values")
    if jobs is not None and resume is None and not several:
        raise DockctlError("--jobs: only a sweep has parallel runs; give --seeds, or several values")
    if resume is not None:
        if extra := [option for option, value in start.items() if value not in (None, [])]:
            raise DockctlError(f"--resume continues the run with its own settings: omit {', '.join(extra)}")
        path = Path(resume) if resume else RunDirectory.latest_interrupted(RUNS).path
        ending = experiments.resume(
            path,
            steps=steps,
            on_divergence=on_divergence,
            device=device,
            sim_device=sim_device,
            trust=trust,
            log=log or (),
        ).reason
    else:
        source, settings = DEFAULT_SCENARIO if scenario is None else scenario, set_ or []
        options: dict[str, Any] = {
            "seed": seed, "steps": steps, "start_from": from_, "on_divergence": on_divergence,
            "plugin_files": plugin or (), "device": device, "sim_device": sim_device, "trust": trust,
            "name": name, "tags": tag or (), "log": log or (),
        }  # fmt: skip
        if several:
            ending, rows = sweep(source, settings, seeds or 1, out or SWEEPS, jobs, **options)
            if json_:
                json_.write(rows)
        else:
            ending = experiments.train(source, overrides=settings, out=out or RUNS, **options).reason
    if ending == "interrupted":
        raise typer.Exit(INTERRUPTED)
    if ending == "failed":
        raise typer.Exit(FAILED)
