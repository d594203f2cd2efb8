"""Time the parts of a decision along greedy episodes."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd
from gymnasium.spaces import flatdim
from rich import box
from rich.console import Console
from rich.table import Table

from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.policy import GreedyPolicy, Policy
from dockctl.analysis.latency import PARTS, STATISTICS, THESIS_FORWARD_MS, summarize
from dockctl.commands.options import DEFAULT_SCENARIO, RUNS
from dockctl.console import say
from dockctl.envs.observation import View
from dockctl.envs.spaces import ObservationEncoder
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.outputs import Places
from dockctl.evaluation.policies import Trained, find
from dockctl.evaluation.starts import judging_starts
from dockctl.reports.latency import latency_figure
from dockctl.reports.style import house_style, save
from dockctl.runs.directory import RunDirectory, require_writable
from dockctl.runs.files import write_atomically
from dockctl.runs.provenance import hardware
from dockctl.sim.checks import load_checked

WARM_UP = 20  # decisions that are not counted: compilation, tables, caches


@dataclass(frozen=True)
class Subject:
    """What is timed: a policy in an environment of one boat, and where the results go."""

    name: str
    policy: Policy
    env: DockingVectorEnv
    places: Places


def latency(ckpt: Path | None, source: str | None, decisions: int, out: Path | None) -> None:
    """Time `decisions` decisions or a few more, print a table and write histogram, samples and summary.

    Raises:
        DockctlError: no such policy or scenario, they do not fit, or `out` cannot be written.
    """
    console = Console()
    subject = _subject(ckpt, source, out)
    folder, stem = subject.places.figures, subject.places.stem
    say(console, f"Timing {subject.name}")
    samples = time_decisions(subject.env, subject.policy, decisions)
    period_ms = 1000 * subject.env.scenario.vessel.control_period_s
    summary = summarize(samples)
    with house_style():
        written = save(
            {stem: latency_figure(samples, f"{subject.name}; {len(samples):,} decisions", period_ms)},
            folder,
        )
    facts = {
        "subject": subject.name,
        "policy": {"sha256": subject.places.policy},
        "decisions": len(samples),
        "milliseconds": {name: summary[part] for part, name in PARTS.items()},
        "thesis_forward_ms": THESIS_FORWARD_MS,
        "control_period_ms": period_ms,
        "hardware": hardware(),
    }
    csv = samples.to_csv(index_label="decision", float_format="%.6g", lineterminator="\n")
    written.append(write_atomically(folder / f"{stem}.csv", csv.encode()))
    written.append(write_atomically(folder / f"{stem}.json", (json.dumps(facts, indent=2) + "\n").encode()))
    console.print(_table(summary))
    say(console, verdict(summary, period_ms))
    for path in written:
        say(console, str(path))


def time_decisions(env: DockingVectorEnv, policy: Policy, decisions: int) -> pd.DataFrame:
    """Play greedy episodes of one boat from the test poses, whole ones, until at least `decisions` are timed.

    Each decision is timed where the boat is: scan, state, forward pass with the choice of the action.

    Returns:
        a row a decision, columns `dockctl.reports.latency.PARTS` [ms].
    """
    scenario, simulator = env.scenario, env.simulator
    encoder = ObservationEncoder(scenario.observation, scenario.sensors.lidar.sectors)
    starts = judging_starts(scenario, env.worlds)
    rows: list[tuple[float, ...]] = []
    episode, ended = 0, True
    while len(rows) < WARM_UP + decisions or not ended:
        if ended:
            env.reset(seed=0, options={"starts": [starts[episode % len(starts)]]})
            episode += 1
        begin = perf_counter()
        ranges = simulator.scan()
        scanned = perf_counter()
        observation = encoder(View.of(simulator, ranges))
        seen = perf_counter()
        action = policy.act(observation, {})
        done = perf_counter()
        rows.append((scanned - begin, seen - scanned, done - seen, done - begin))
        _, _, terminated, truncated, _ = env.step(action)
        ended = bool(terminated[0] or truncated[0])
    return pd.DataFrame(1000 * np.array(rows[WARM_UP:]), columns=list(PARTS))


def verdict(summary: dict[str, dict[str, float]], control_period_ms: float) -> str:
    """How the times compare with the thesis' forward pass and with the control period, in two lines."""
    forward, decision = summary["forward_ms"]["p50"], summary["decision_ms"]["max"]
    return (
        f"Forward pass: {forward:.3g} ms at the median, {THESIS_FORWARD_MS / forward:.1f} times as fast as"
        f" the thesis' {THESIS_FORWARD_MS:g} ms (another machine).\n"
        f"Slowest whole decision: {decision:.3g} ms, {decision / control_period_ms:.1%} of the control period"
        f" of {control_period_ms:g} ms."
    )


def _subject(ckpt: Path | None, source: str | None, out: Path | None) -> Subject:
    """The policy that was asked for, that of the latest run, or a new network where there is no run."""
    trained = _trained(ckpt)
    if trained is None:
        loaded = load_checked(source or DEFAULT_SCENARIO)
        env = DockingVectorEnv(loaded, 1)
        sizes = loaded.scenario.training.hidden_sizes
        network = DuelingQNetwork(len(env.observation_names), flatdim(env.single_action_space), sizes)
        name = f"a new network with random weights, on scenario {loaded.scenario.name}"
        folder = out or Path("figures") / "latency"
        require_writable(folder)
        return Subject(name, GreedyPolicy(network), env, Places(folder, folder, "latency", None, ""))
    loaded, card = trained.scenario(source), trained.card
    places = Places.of("latency", trained, loaded.scenario, source, out, None)
    env = DockingVectorEnv(loaded, 1)
    trained.require_fit(env)
    name = f"the policy trained on {card.scenario} (seed {card.seed}), on scenario {env.scenario.name}"
    return Subject(name, trained.policy, env, places)


def _trained(ckpt: Path | None) -> Trained | None:
    if ckpt is None:
        try:
            ckpt = RunDirectory.latest(RUNS).path
        except DockctlError:
            return None
    return find(ckpt)


def _table(summary: dict[str, dict[str, float]]) -> Table:
    table = Table(header_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("ms")
    for name in STATISTICS:
        table.add_column(name, justify="right")
    for part, row in summary.items():
        table.add_row(PARTS[part], *(f"{row[name]:.3f}" for name in STATISTICS))
    return table
