"""Play behaviors and let the reward judge them under several readings of the unit of the distance."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.table import Table

from dockctl.analysis.returns import AT_GATE, AT_START, DOCKING, unit_words, verdicts
from dockctl.console import say
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.outputs import Places
from dockctl.evaluation.policies import Trained, find
from dockctl.evaluation.starts import player
from dockctl.plugins import REWARD_TERMS
from dockctl.reports.returns import returns_figure
from dockctl.reports.style import house_style, save
from dockctl.rewards.compose import RewardFunction
from dockctl.runs.tables import RETURNS, Value, all_columns, to_csv
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Reward, Scenario
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, given_start, own_site
from dockctl.sim.status import StepStatus
from dockctl.sim.vessel import VesselModel
from dockctl.sim.world import World, build_worlds

Floats = NDArray[np.float64]

HELD = (
    ("full ahead", 1.0, 0.0), ("full ahead, rudder +", 1.0, 1.0), ("full ahead, rudder −", 1.0, -1.0),
    ("full astern", -1.0, 0.0), ("full astern, rudder +", -1.0, 1.0), ("full astern, rudder −", -1.0, -1.0),
)  # fmt: skip
"""Commands that are held for an episode: name, propeller and rudder angle in parts of their limits."""


@dataclass(frozen=True, eq=False)
class Behavior:
    """What a boat does from the start on, and what came of each control step."""

    name: str
    outcome: str
    statuses: tuple[StepStatus, ...]

    @property
    def gate_at(self) -> int | None:
        """Number of the step, from 0, that reached the intermediate pose."""
        return next((i for i, status in enumerate(self.statuses) if status.reached_intermediate[0]), None)


@dataclass(frozen=True, eq=False)
class Water:
    """Where behaviors are played: a scenario and a start in one of its harbors."""

    scenario: Scenario
    worlds: Sequence[World]
    start: Start

    def play(self, name: str, commands: Floats) -> Behavior:
        """Give the commands (k, 2) [N, rad], the last one until the episode ends."""
        simulator = Simulator(self.scenario, self.worlds, 1)
        simulator.reset(np.array([0]), [self.start])
        statuses: list[StepStatus] = []
        for step in range(self.start.max_steps):
            status = simulator.step(commands[[min(step, len(commands) - 1)]])
            statuses.append(status)
            for outcome, happened in (("collision", status.collided), ("docked", status.reached_final)):
                if happened[0]:
                    return Behavior(name, outcome, tuple(statuses))
        return Behavior(name, "timeout", tuple(statuses))


def readings(text: str) -> tuple[float, ...]:
    """Read units of the distance [m], like ``20,1``.

    Raises:
        DockctlError: they are not positive numbers, or one comes twice.
    """
    try:
        units = tuple(float(part) for part in text.split(","))
    except ValueError:
        units = ()
    if not units or len({*units}) < len(units) or not all(0 < unit < math.inf for unit in units):
        raise DockctlError(f"--units '{text}': give different lengths in meters with commas, like 20,1")
    return units


def compare(
    ckpt: Path | None, source: str | None, units: Sequence[float], csv: Path | None, out: Path | None
) -> None:
    """Play and judge the behaviors, print a table, and write table and figure.

    Raises:
        DockctlError: there is no such policy or scenario, they do not fit, the policy does not dock, or a
            file cannot be written.
    """
    trained = find(ckpt)
    loaded = trained.scenario(source)
    scenario = loaded.scenario
    places = Places.of("returns", trained, scenario, source, out, csv)
    with Console(stderr=True).status(f"behaviors on '{scenario.name}'"):
        played = list(behaviors(loaded, trained))
        rows = [row for unit in units for row in judge(scenario, unit, played)]
    text = to_csv(rows, all_columns(RETURNS, rows))
    table = pd.read_csv(io.StringIO(text), keep_default_na=False, na_values=[""])
    show(table, trained, scenario)
    caption = (
        f"scenario {scenario.name}, policy of {trained.card.scenario}, seed {trained.card.seed};"
        f" discounted by {scenario.training.gamma:g} a step"
    )
    with house_style():
        places.store(text, save({places.stem: returns_figure(table, caption)}, places.figures))


def behaviors(loaded: LoadedScenario, trained: Trained) -> Iterator[Behavior]:
    """Yield docking, loitering at the start and at the gate, and what held commands come to, by their length.

    Raises:
        DockctlError: the policy does not fit the scenario, or does not dock in it.
    """
    scenario, worlds = loaded.scenario, build_worlds(loaded.scenario, loaded.base_dir)
    trained.require_fit(DockingVectorEnv(loaded, 1, worlds=worlds))
    site = own_site(scenario)
    water = Water(scenario, worlds, given_start(site, scenario.task, site.initial[0], 0))
    (episode,) = player(loaded, worlds, [water.start])(trained.policy)
    if not episode.docked:
        raise DockctlError(f"{trained.file}: does not dock from the first initial pose of '{scenario.name}'")
    course = episode.course["command"][1:]
    docking = water.play(DOCKING, course)
    yield docking
    yield water.play(AT_START, np.zeros((1, 2)))
    if docking.gate_at is not None and (loitering := loiter_at_gate(water, course, docking.gate_at)):
        yield loitering
    limits = VesselModel(scenario.vessel).command_limit
    held = [water.play(name, limits * [[propeller, rudder]]) for name, propeller, rudder in HELD]
    yield from sorted(held, key=lambda behavior: len(behavior.statuses))


def loiter_at_gate(water: Water, course: Floats, gate_at: int) -> Behavior | None:
    """Follow the course towards the intermediate pose, and stop the propeller just too soon to reach it.

    Args:
        course: commands (k, 2) of an episode that reaches the pose in step `gate_at`.

    Returns:
        None where there is no such way: stopped anywhere, the boat drifts through the pose or hits something.
    """
    stops = (
        water.play(AT_GATE, np.concatenate([course[:step], np.zeros((1, 2))]))
        for step in range(gate_at, -1, -1)
    )
    return next((b for b in stops if b.gate_at is None and b.outcome == "timeout"), None)


def judge(scenario: Scenario, unit_m: float, played: Sequence[Behavior]) -> Iterator[dict[str, Value]]:
    """Yield a row for each behavior: its discounted return and what each term gave to it.

    `gate_discount` is what a reward of one for the intermediate pose adds to the return.
    """
    gamma = scenario.training.gamma
    reward = scenario.reward.model_copy(update={"distance_unit_m": unit_m})
    function, gate = RewardFunction(reward), RewardFunction(_gate_alone(reward))
    for behavior in played:
        terms = [function(status)[1] for status in behavior.statuses]
        sums = {name: discounted([term[name][0] for term in terms], gamma) for name in function.names}
        at_gate = [gate(status)[0][0] for status in behavior.statuses]
        yield {
            "behavior": behavior.name,
            "outcome": behavior.outcome,
            "steps": len(behavior.statuses),
            "time_s": len(behavior.statuses) * scenario.vessel.control_period_s,
            "distance_unit_m": unit_m,
            "return": sum(sums.values()),
            "gate_discount": discounted(at_gate, gamma),
            **{f"reward_{name}": value for name, value in sums.items()},
        }


def discounted(rewards: Sequence[float], gamma: float) -> float:
    """Return the sum of gamma to the power of t times the reward of step t, from t = 0."""
    return float(np.power(gamma, np.arange(len(rewards))) @ np.asarray(rewards, float))


def _gate_alone(reward: Reward) -> Reward:
    """The reward with a weight of one for the intermediate pose, and nothing else."""
    terms = [term for term in reward.terms if REWARD_TERMS.get(term.term).kind == "intermediate"]
    return reward.model_copy(update={"terms": tuple(t.model_copy(update={"weight": 1.0}) for t in terms)})


def show(table: pd.DataFrame, trained: Trained, scenario: Scenario) -> None:
    """Print the returns under every reading, the best first, and what follows from them."""
    console = Console()
    say(
        console,
        f"Discounted returns on scenario '{scenario.name}' (gamma {scenario.training.gamma:g}); docking is"
        f" the greedy episode of {trained.file}",
    )
    for unit, rows in table.groupby("distance_unit_m", sort=False):
        shown = Table(
            title=f"δd in {unit_words(float(str(unit)))}", title_justify="left", box=box.SIMPLE_HEAD
        )
        shown.add_column("behavior")
        for name in ("ends", "time", "return"):
            shown.add_column(name, justify="right", no_wrap=True)
        for _, row in rows.sort_values("return", ascending=False).iterrows():
            shown.add_row(row["behavior"], row["outcome"], f"{row['time_s']:g} s", f"{row['return']:,.0f}")
        console.print(shown)
        for verdict in verdicts(rows):
            say(console, verdict)
