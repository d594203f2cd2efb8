"""A training from the scenario to the run folder: begin or take up, carry out, tell."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from dockctl.agents.checkpoint import LEARNER, load_pair, load_policy
from dockctl.agents.policy import GreedyPolicy
from dockctl.agents.progress import REASONS, Progress
from dockctl.agents.trainer import Trainer
from dockctl.analysis.learning import RECENT
from dockctl.console import say
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.rollout import Rollout, trajectories_csv
from dockctl.evaluation.starts import trajectory_starts, validation_starts
from dockctl.experiments.interrupt import on_interrupt
from dockctl.experiments.live import TrainingDisplay, best, clock
from dockctl.experiments.memory import Estimate, require_memory
from dockctl.runs import provenance
from dockctl.runs.directory import PROVENANCE, SCENARIO, RunDirectory, require_writable
from dockctl.runs.lock import exclusive_lock
from dockctl.scenarios.content import mesh_files, with_paths
from dockctl.scenarios.interface import PolicyInterface
from dockctl.scenarios.loader import LoadedScenario, dump
from dockctl.sim.checks import load_checked
from dockctl.sim.starts import own_site
from dockctl.sim.world import World, build_worlds


@dataclass(frozen=True, eq=False)
class Session:
    """A training that is ready to start, in a run folder that no other process works in."""

    loaded: LoadedScenario
    worlds: Sequence[World]
    run: RunDirectory
    memory: Estimate
    taken_up: bool


@contextmanager
def begin(source: str, overrides: list[str], plugin_files: list[Path], out: Path) -> Iterator[Session]:
    """Load the scenario, build its world and make the run folder; nothing is written before all is right.

    Raises:
        DockctlError: the scenario is wrong, `out` cannot be written to, or there is not the memory.
    """
    loaded = load_checked(source, overrides=overrides, plugin_files=plugin_files)
    require_writable(out)
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    memory = require_memory(loaded.scenario, worlds)
    seed = loaded.scenario.training.seed
    run = RunDirectory.create(out, loaded.scenario.name, seed)
    with exclusive_lock(run.path):
        facts = provenance.collect(seed, sys.argv)
        facts["plugins"] = run.copy_files("plugins", loaded.plugin_files)
        facts["meshes"] = run.copy_files("meshes", mesh_files(loaded.scenario))
        run.write_text(SCENARIO, dump(with_paths(loaded.scenario, facts["plugins"], facts["meshes"])))
        run.write_json("scene.json", worlds[own_site(loaded.scenario).harbor].scene().to_json())
        run.write_json(PROVENANCE, facts)
        yield Session(loaded, worlds, run, memory, taken_up=False)


@contextmanager
def take_up(path: Path, steps: int | None) -> Iterator[Session]:
    """Open a run to go on with it; a finished one only when `steps` reaches past its end, without stop rule.

    Raises:
        DockctlError: `path` is no run, has no checkpoint, is finished, or another process works in it, or
            there is not the memory.
    """
    run = RunDirectory.open(path)
    with exclusive_lock(run.path):
        yield _taken_up(run, steps)


def _taken_up(run: RunDirectory, steps: int | None) -> Session:
    facts = run.read_json(PROVENANCE)
    _, card = load_pair(run.checkpoint("last") / "policy.json")
    load_pair(run.checkpoint("last") / f"{LEARNER}.json")  # before anything is written
    overrides = [] if steps is None else [f"training.total_steps={steps}"]
    if not {"finished", "stop_reason"} <= facts.keys():
        raise DockctlError(f"{run.path / PROVENANCE}: does not tell whether the run is finished")
    if facts["finished"]:
        done = card["env_steps"]
        if steps is None or steps <= done:
            reason = REASONS.get(facts["stop_reason"], "finished").lower()
            raise DockctlError(
                f"{run.path}: this training is over: {reason} at {done:,} steps;"
                " to go on give --steps above that"
            )
        overrides += ["training.stop=null", "training.max_episodes=null"]
    loaded = load_checked(run.path / SCENARIO, overrides=overrides)
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    memory = require_memory(loaded.scenario, worlds)
    if overrides:
        plugins = map(run.inside, loaded.scenario.plugins)
        meshes = [run.inside(str(path)) for path in mesh_files(loaded.scenario)]
        run.write_text(SCENARIO, dump(with_paths(loaded.scenario, plugins, meshes)))
    again = {"at": provenance.now(), "env_steps": card["env_steps"], "command": sys.argv}
    facts |= {"finished": None, "stop_reason": None, "taken_up": [*facts.get("taken_up", []), again]}
    run.write_json(PROVENANCE, facts)
    return Session(loaded, worlds, run, memory, taken_up=True)


def carry_out(session: Session, device: str) -> str:
    """Train, record the best policy's trajectories, tell what came of it; return the reason for the end."""
    loaded, run, console = session.loaded, session.run, Console()
    scenario, training = loaded.scenario, loaded.scenario.training
    env = DockingVectorEnv(loaded, training.boats, exploring=True, worlds=session.worlds)
    rollout = Rollout(loaded, session.worlds)
    starts = validation_starts(scenario, session.worlds)
    title = f"{scenario.name}, seed {training.seed}"
    boats = f"{training.boats} boat{'s' * (training.boats > 1)}"
    say(console, f"{title}: {boats}; memory: {session.memory}")
    say(console, f"run folder: {run.path}")
    with asked_to_leave() as asked, TrainingDisplay(training, title, console) as display:
        trainer = Trainer(
            training, scenario.name, env, lambda policy: rollout.play(policy, starts), run,
            interface=PolicyInterface.of(scenario), device=device, on_progress=display, interrupted=asked,
        )  # fmt: skip
        if session.taken_up:
            trainer.restore()
        reason = trainer.run()
        display.show_evaluation(trainer.progress)
    facts = run.read_json(PROVENANCE)
    facts |= {"finished": None if reason == "interrupted" else provenance.now(), "stop_reason": reason}
    run.write_json(PROVENANCE, facts)
    if trainer.progress.best is not None:
        network, _ = load_policy(run.checkpoint("best"))
        shown = rollout.play(GreedyPolicy(network), trajectory_starts(scenario, session.worlds))
        text = trajectories_csv(shown, scenario.vessel.control_period_s)
        run.write_text("trajectories.csv", text)
    tell(console, run, trainer.progress, reason)
    return reason


def tell(console: Console, run: RunDirectory, progress: Progress, reason: str) -> None:
    """Print how the training ended and what to do next."""
    made = f"{progress.env_steps:,} steps, {progress.episodes:,} episodes, {clock(progress.wall_s)}"
    lines = [
        f"{REASONS[reason]}: {made}.",
        f"Training: docked {progress.recent_docked} of the last {min(RECENT, progress.episodes)} episodes.",
        f"Greedy: best {best(progress)}.",
    ]
    if reason == "interrupted":
        lines += ["Saved. To go on:", f"  dockctl train --resume {run.path}"]
    else:
        lines += ["Next:", f"  dockctl evaluate --ckpt {run.path}", f"  dockctl plot {run.path}"]
    say(console, "\n".join(lines))


@contextmanager
def asked_to_leave() -> Iterator[Callable[[], bool]]:
    """Give a function that tells whether Ctrl-C was pressed; a second one leaves at once."""
    asked = False

    def remember() -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    with on_interrupt(remember):
        yield lambda: asked
