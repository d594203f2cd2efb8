"""Training a scenario into a run folder: start, resume, run."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from dockctl.agents.algorithms import AlgorithmSpec, algorithm_of, remember_code
from dockctl.agents.checkpoint import PolicyCard, load_policy, require_imports
from dockctl.agents.divergence import DivergenceError
from dockctl.agents.interface import Algorithm, Policy, Spaces
from dockctl.agents.progress import REASONS, Progress
from dockctl.agents.tensors import torch_device
from dockctl.agents.trainer import Trainer
from dockctl.agents.training_state import load_state
from dockctl.console import command_line, count, print_text
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.rollout import Rollout, evaluation_rows, trajectories_csv
from dockctl.evaluation.starts import evaluation_poses, trajectory_starts, validation_starts
from dockctl.experiments.dry_run import build_algorithm, dry_run
from dockctl.experiments.fine_tuning import InitialPolicy
from dockctl.experiments.interrupt import interruptible
from dockctl.experiments.live import TrainingDisplay, best, clock
from dockctl.experiments.logs import logged, require_logs
from dockctl.experiments.memory import Estimate, require_memory
from dockctl.plugins import ALGORITHMS, Guard
from dockctl.run_files import BEST, LAST, MESHES, PLUGINS, PROVENANCE, RUNS, SCENARIO, SCENE, TRAJECTORIES_CSV
from dockctl.runs import provenance
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import all_or_nothing, exclusive_lock, require_writable
from dockctl.runs.tables import RECENT, Value
from dockctl.scenarios.content import mesh_files, with_paths
from dockctl.scenarios.loader import LoadedScenario, dump
from dockctl.scenarios.schema import PolicyInterface, Scenario
from dockctl.sim.checks import load_checked, notes
from dockctl.sim.devices import CPU, require_device
from dockctl.sim.starts import is_trained, own_site, sites
from dockctl.sim.world import World, build_worlds


@dataclass(frozen=True, eq=False)
class TrainedRun:
    """A training run that ended or was interrupted.

    Attributes:
        path: the run folder, which other functions and commands accept.
        reason: why it ended, a key of `REASONS`.
        progress: its counters.
    """

    path: Path
    reason: str
    progress: Progress


def train(
    scenario: str | Path,
    *,
    seed: int | None = None,
    steps: int | None = None,
    start_from: str | Path | None = None,
    on_divergence: str | None = None,
    overrides: Sequence[str] = (),
    plugin_files: Sequence[str | Path] = (),
    out: str | Path = RUNS,
    device: str = "cpu",
    sim_device: str = "cpu",
    trust: bool = False,
    name: str | None = None,
    tags: Sequence[str] = (),
    log: Sequence[str] = (),
    console: Console | None = None,
) -> TrainedRun:
    """Train a policy into a new run folder.

    Args:
        scenario: name or file of the scenario.
        seed: ``training.seed``.
        steps: ``training.total_steps``.
        start_from: a trained policy to fine-tune: run folder, checkpoint, or its name.
        on_divergence: ``training.on_divergence``.
        overrides: changed values of the scenario, ``key=value``.
        plugin_files: local ``.py`` files to load.
        out: parent of ``<scenario>/<time>-seed<N>/``.
        device: torch device of the networks.
        sim_device: "cpu", or "cuda" to simulate on an NVIDIA GPU.
        trust: run the plugins of a received scenario, see `dockctl.scenarios.loader.load`.
        name: name of the run, for its provenance.
        tags: tags of the run, for its provenance.
        log: ``tensorboard`` or ``wandb``, to log the tables; see `dockctl.experiments.logs`.
        console: shows the progress; standard output by default.

    Raises:
        DockctlError: the scenario is invalid, `out` is not writable, or device or memory are not available;
            then nothing is written.
    """
    torch_device(device)
    require_device(sim_device)
    require_logs(log)
    out, plugins = Path(out), [Path(file) for file in plugin_files]
    changes = {
        "training.seed": seed,
        "training.total_steps": steps,
        "training.on_divergence": on_divergence,
    }
    given = [f"{key}={value}" for key, value in changes.items() if value is not None]
    loaded = load_checked(scenario, overrides=[*overrides, *given], plugin_files=plugins, trust=trust)
    if loaded.is_given_by_others("training.algorithm.model"):
        require_imports(algorithm_of(loaded.scenario.training), trust=trust)
    initial = None if start_from is None else InitialPolicy.load(start_from, trust=trust)
    require_writable(out)
    session = _prepare(loaded, device, sim_device, initial)
    scenario_name, own_seed = loaded.scenario.name, loaded.scenario.training.seed
    with ExitStack() as locked:
        with all_or_nothing(out / scenario_name) as new:
            run = RunDirectory.create(out, scenario_name, own_seed)
            new.append(run.path)
            locked.enter_context(exclusive_lock(run.path))
            facts = provenance.collect(own_seed, sys.argv)
            facts |= {"name": name, "tags": [*tags]}
            if initial is not None:
                initial.save(run)
                facts["initial"] = initial.facts
            facts["sequence"] = RunDirectory.next_sequence(out)
            facts["plugins"] = run.copy_files(PLUGINS, loaded.plugin_files)
            facts["meshes"] = run.copy_files(MESHES, mesh_files(loaded.scenario))
            run.write_text(SCENARIO, dump(with_paths(loaded.scenario, facts["plugins"], facts["meshes"])))
            run.write_json(SCENE, session.worlds[own_site(loaded.scenario).harbor].scene().to_json())
            facts |= {"log": [*log], "total_steps": loaded.scenario.training.total_steps}
            run.write_json(PROVENANCE, facts)
        remember_code(session.loaded.scenario)
        with logged(run, log):
            return _run(session, run, console or Console(), resumed=False)


def resume(
    path: str | Path,
    *,
    steps: int | None = None,
    on_divergence: str | None = None,
    device: str = "cpu",
    sim_device: str = "cpu",
    trust: bool = False,
    log: Sequence[str] = (),
    console: Console | None = None,
) -> TrainedRun:
    """Continue an interrupted run, or extend a finished one to `steps`, without its stop rule.

    A run that continues with its own number of steps gives the same bytes as an uninterrupted one. With other
    `steps`, everything that depends on the total changes from here on: the learning rate and the number of
    updates between rows of ``updates.csv``.

    Args:
        trust: run the plugins of a run from someone else, see `dockctl.scenarios.loader.load`.
        log: further logs; those that the run was started with continue.

    Raises:
        UntrustedError: the run has plugins that may not run.
        DockctlError: `path` is not a run, has no intact checkpoint, is finished, has made more than `steps`,
            or is in use, or device or memory are not available; then nothing is written.
    """
    torch_device(device)
    require_device(sim_device)
    run = RunDirectory.open(Path(path))
    with exclusive_lock(run.path):
        facts = _facts(run)
        own = facts.get("log", [])
        logs = [*dict.fromkeys([*(map(str, own) if isinstance(own, list) else ()), *log])]
        require_logs(logs)
        made = load_state(run).env_steps
        overrides = _extension(run, facts, made, steps)
        if on_divergence is not None:
            overrides.append(f"training.on_divergence={on_divergence}")
        loaded = load_checked(run.path / SCENARIO, overrides=overrides, received=True, trust=trust)
        require_imports(algorithm_of(loaded.scenario.training), trust=trust)
        session = _prepare(loaded, device, sim_device)
        if overrides:
            plugins = map(run.inside, loaded.scenario.plugins)
            meshes = [run.inside(str(path)) for path in mesh_files(loaded.scenario)]
            run.write_text(SCENARIO, dump(with_paths(loaded.scenario, plugins, meshes)))
        again = {"at": provenance.now(), "env_steps": made, "command": sys.argv}
        if steps is not None:
            again["total_steps"] = steps
        facts |= {"finished": None, "stop_reason": None, "resumed": [*facts.get("resumed", []), again]}
        facts["log"] = logs
        run.write_json(PROVENANCE, facts)
        remember_code(session.loaded.scenario)
        with logged(run, logs):
            return _run(session, run, console or Console(), resumed=True)


def replay(
    run: RunDirectory, steps: int, out: Path, *, plugin_files: Sequence[Path] = (), trust: bool = False
) -> RunDirectory:
    """Repeat the first steps of a run in a new run folder under `out`, and return it.

    Raises:
        DockctlError: the scenario of the run is damaged, or its plugins may not run.
    """
    first = run.read_json(PROVENANCE).get("total_steps")  # before the run was extended
    overrides = [f"training.total_steps={first}"] if isinstance(first, int) else []
    loaded = load_checked(
        run.path / SCENARIO, overrides=overrides, plugin_files=plugin_files, received=True, trust=trust
    )
    require_imports(algorithm_of(loaded.scenario.training), trust=trust)
    session = _prepare(loaded, CPU, CPU, InitialPolicy.of_run(run))
    repeated = RunDirectory.create(out, loaded.scenario.name, loaded.scenario.training.seed)
    repeated.write_json(PROVENANCE, provenance.collect(loaded.scenario.training.seed, sys.argv))
    _run(session, repeated, Console(quiet=True), resumed=False, until=steps)
    return repeated


def _facts(run: RunDirectory) -> dict[str, Any]:
    """Return the provenance.

    Raises:
        DockctlError: it is missing or damaged.
    """
    try:
        return run.read_json(PROVENANCE)
    except DockctlError as error:
        least = json.dumps({"finished": None, "stop_reason": None})
        message = f"{error.message}; to resume from the checkpoint, restore it, or replace it with {least}"
        raise DockctlError(message, code=error.code) from None


def _extension(run: RunDirectory, facts: Mapping[str, Any], env_steps: int, steps: int | None) -> list[str]:
    """Return the overrides with which the run continues.

    Raises:
        DockctlError: `steps` is less than the run has taken, or does not extend a finished run.
    """
    overrides = [] if steps is None else [f"training.total_steps={steps}"]
    if not {"finished", "stop_reason"} <= facts.keys():
        message = f"{run.path / PROVENANCE}: 'finished' or 'stop_reason' is missing"
        raise DockctlError(message, code="missing_key")
    if not facts["finished"]:
        if steps is not None and steps < env_steps:
            made = count(env_steps, "step")
            message = f"{run.path}: --steps {steps} is less than this run has taken: {made}"
            raise DockctlError(message, code="out_of_range")
        return overrides
    if steps is None or steps <= env_steps:
        reason = REASONS.get(facts["stop_reason"], "finished").lower()
        raise DockctlError(
            f"{run.path}: this run is finished: {reason} after {count(env_steps, 'step')};"
            " to extend it, give a larger number with --steps"
        )
    return [*overrides, "training.stop=null", "training.max_episodes=null"]


@dataclass(frozen=True, eq=False)
class _Session:
    """Everything that training needs before its run folder is written."""

    loaded: LoadedScenario
    worlds: Sequence[World]
    memory: Estimate
    environment: DockingVectorEnv
    spec: AlgorithmSpec
    algorithm: Algorithm


def _prepare(
    loaded: LoadedScenario, device: str, sim_device: str, initial: InitialPolicy | None = None
) -> _Session:
    """Build worlds, environment and algorithm, after a dry run.

    Raises:
        DockctlError: a plugin fails, the algorithm or the initial policy is incompatible, or device or memory
            are not available.
    """
    training = loaded.scenario.training
    dry_run(loaded)
    if initial is not None:  # before the harbors are built, which can take a minute
        initial.require_fit(loaded.scenario)
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    used = sorted({site.harbor for site in sites(loaded.scenario) if is_trained(site)})
    memory = require_memory(loaded.scenario, [worlds[number] for number in used])
    stepped = replace(loaded, scenario=loaded.scenario.in_training())
    environment = DockingVectorEnv(stepped, training.boats, exploring=True, worlds=worlds, device=sim_device)
    environment.simulator.prepare(used)
    algorithm = build_algorithm(loaded, Spaces.from_env(environment), training.boats, device)
    if initial is not None:
        initial.start(algorithm, loaded.scenario)
    return _Session(loaded, worlds, memory, environment, algorithm_of(training), algorithm)


def _run(
    session: _Session, run: RunDirectory, console: Console, *, resumed: bool, until: int | None = None
) -> TrainedRun:
    """Train, write the trajectories of the best policy, and report.

    Args:
        until: stop as if interrupted when all rows of the first `until` environment steps are written.
    """
    loaded, scenario, training = session.loaded, session.loaded.scenario, session.loaded.scenario.training
    title = f"{scenario.name}, seed {training.seed}"
    print_text(console, f"{title}: {count(training.boats, 'boat')}; memory: {session.memory}")
    print_text(console, f"run folder: {run.path}")
    for note in notes(loaded):
        print_text(console, f"note: {note}", "yellow")
    card = PolicyCard.for_spaces(
        Spaces.from_env(session.environment),
        scenario=scenario.name,
        hidden_sizes=training.hidden_sizes,
        seed=training.seed,
        interface=PolicyInterface.of(scenario),
        algorithm=training.algorithm.model_dump(mode="json"),
    )
    rollout = Rollout(loaded, session.worlds)
    poses, starts = evaluation_poses(scenario), validation_starts(scenario, session.worlds)

    def evaluate(policy: Policy) -> list[dict[str, Value]]:
        return evaluation_rows(rollout.run(policy, poses))

    def validate(policy: Policy) -> list[dict[str, Value]]:
        return evaluation_rows(rollout.validate(policy, starts))

    with interruptible(partial(print_text, console, "stopping: saving the run")) as interrupted:

        def warn(text: str) -> None:
            print_text(console, f"warning: {text}", "yellow")

        with TrainingDisplay(training, title, console) as display:
            trainer = Trainer(
                session.algorithm, training, session.environment, run, card,
                validate, evaluate if poses else None,
                on_progress=display, interrupted=interrupted, until=until, warn=warn,
                step_limit=_step_limit(session.environment.scenario),
            )  # fmt: skip
            if resumed:
                warnings = trainer.restore()
                print_text(console, f"resumed after {count(trainer.progress.env_steps, 'step')}")
                for warning in warnings:
                    warn(warning)
            try:
                with Guard(ALGORITHMS, session.spec.kind):
                    reason = trainer.run()
            except DivergenceError:
                run.write_json(PROVENANCE, run.read_json(PROVENANCE) | {"stop_reason": "diverged"})
                raise
            display.finish(trainer.progress)
        if trainer.progress.best is not None:
            policy, _ = load_policy(run.checkpoint(BEST))
            shown = rollout.run(policy, trajectory_starts(scenario, session.worlds))
            run.write_text(TRAJECTORIES_CSV, trajectories_csv(shown, scenario.vessel.control_period_s))
        facts = run.read_json(PROVENANCE)  # written last, so that a run marked as finished is complete
        facts |= {"finished": None if reason == "interrupted" else provenance.now(), "stop_reason": reason}
        run.write_json(PROVENANCE, facts)
    result = TrainedRun(run.path, reason, trainer.progress)
    _report(console, result)
    return result


def _step_limit(scenario: Scenario) -> int:
    exploring = scenario.training.exploring_starts
    return max(scenario.task.max_steps, exploring.steps if exploring else 0)


def _report(console: Console, run: TrainedRun) -> None:
    """Print how training ended and what to do next."""
    progress, recent = run.progress, min(RECENT, run.progress.episodes)
    steps, episodes = count(progress.env_steps, "step"), count(progress.episodes, "episode")
    lines = [
        f"{REASONS[run.reason]}: {steps}, {episodes}, {clock(progress.wall_s)}.",
        f"Training: {progress.recent_docked} of the last {count(recent, 'episode')} docked.",
        f"Best policy: {best(progress)}.",
    ]
    if run.reason == "interrupted":
        lines += ["Saved. To continue:", f"  {command_line('train', '--resume', run.path)}"]
    else:
        # If training diverged before the first checkpoint, there is nothing to evaluate.
        saved = any(map(RunDirectory(run.path).checkpoints, (BEST, LAST)))
        following = ("evaluate", "plot") if saved else ("plot",)
        lines += ["Next:", *(f"  {command_line(name, run.path)}" for name in following)]
    print_text(console, "\n".join(lines))
