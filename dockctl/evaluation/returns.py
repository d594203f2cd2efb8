"""Discounted returns of behaviors: which one the reward favors, for several distance units."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dockctl.analysis.returns import AT_START, BEFORE_INTERMEDIATE, DOCKING, FAILING
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Rollout
from dockctl.geometry import Floats
from dockctl.plugins import REWARD_TERMS
from dockctl.rewards.compose import RewardFunction
from dockctl.runs.tables import RETURNS, Value, all_columns, to_csv
from dockctl.scenarios.schema import Reward, Scenario
from dockctl.sim.goal import StepStatus
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, given_start, own_site
from dockctl.sim.world import World

UNITS_M = (20.0, 1.0)
CONSTANT_COMMANDS = (
    ("full ahead", 1.0, 0.0), ("full ahead, rudder +", 1.0, 1.0), ("full ahead, rudder −", 1.0, -1.0),
    ("full astern", -1.0, 0.0), ("full astern, rudder +", -1.0, 1.0), ("full astern, rudder −", -1.0, -1.0),
)  # fmt: skip
"""Constant commands: name, propeller force and rudder angle as fractions of their limits."""


@dataclass(frozen=True, eq=False)
class Behavior:
    """One episode of a behavior: how it ended, and the status of each control step."""

    name: str
    outcome: str
    statuses: tuple[StepStatus, ...]

    @property
    def intermediate_step(self) -> int | None:
        """Step, from 0, that reached the intermediate pose."""
        return next((i for i, status in enumerate(self.statuses) if status.reached_intermediate[0]), None)


@dataclass(frozen=True, eq=False)
class BehaviorSimulation:
    """Simulates behaviors in a scenario with these harbors, from one start."""

    scenario: Scenario
    worlds: Sequence[World]
    start: Start

    def run(self, name: str, commands: Floats) -> Behavior:
        """Apply the commands (k, 2) [N, rad], and hold the last one until the episode ends."""
        simulator = Simulator(self.scenario, self.worlds, 1)
        simulator.reset(np.array([0]), [self.start])
        statuses: list[StepStatus] = []
        for step in range(self.start.max_steps):
            status = simulator.step(commands[[min(step, len(commands) - 1)]])
            statuses.append(status)
            if status.terminated[0]:
                break
        return Behavior(name, status.outcome(~status.terminated)[0], tuple(statuses))


@dataclass(frozen=True, eq=False)
class Returns:
    """Discounted returns of behaviors.

    Attributes:
        csv: text of ``returns.csv``.
        table: its content, columns `dockctl.runs.tables.RETURNS`.
    """

    policy: LoadedPolicy
    scenario: Scenario
    csv: str

    @property
    def table(self) -> pd.DataFrame:
        return pd.read_csv(io.StringIO(self.csv), keep_default_na=False, na_values=[""])

    def as_json(self) -> dict[str, Any]:
        """Return the behaviors with every distance unit, as plain data."""
        behaviors = self.table.to_dict("records")
        return {"policy": self.policy.facts(), "scenario": self.scenario.name, "behaviors": behaviors}


def returns(
    policy: str | Path | LoadedPolicy | None = None,
    scenario: str | Path | None = None,
    units_m: Sequence[float] = UNITS_M,
    *,
    overrides: Sequence[str] = (),
) -> Returns:
    """Simulate the policy and other behaviors and compute their returns with every distance unit.

    They are the returns of a training: with its steps, step limit and conditions, and without a supervisor or
    planner, which act only in evaluations.

    Args:
        policy: its greedy episode gives the return of docking, if it docks; see
            `dockctl.evaluation.loading.load_policy`.
        scenario: file or name; the policy's own by default.
        units_m: units of the distance in the reward [m].
        overrides: changed values of the scenario, ``key=value``.

    Raises:
        DockctlError: there is no such policy or scenario, or they do not match.
    """
    loaded_policy = load_policy(policy)
    loaded = loaded_policy.scenario(scenario, overrides)
    rollout = Rollout(replace(loaded, scenario=loaded.scenario.in_training()))
    simulated = list(behaviors(rollout, loaded_policy))
    rows = [row for unit_m in units_m for row in evaluate_behaviors(rollout.scenario, unit_m, simulated)]
    return Returns(loaded_policy, rollout.scenario, to_csv(rows, all_columns(RETURNS, rows)))


def behaviors(rollout: Rollout, policy: LoadedPolicy) -> Iterator[Behavior]:
    """Yield the greedy episode, loitering at the start and before the intermediate pose, constant commands.

    Constant commands are sorted by the length of their episodes.

    Raises:
        DockctlError: the policy does not match the scenario.
    """
    scenario, site = rollout.scenario, own_site(rollout.scenario)
    (start,) = rollout.seeded([given_start(site, scenario.task, site.initial[0], 0)])
    simulation = BehaviorSimulation(scenario, rollout.worlds, start)
    (episode,) = rollout.run(policy.make(rollout.env()), [simulation.start])
    commands = episode.trajectory["command"][1:]
    greedy = simulation.run(DOCKING if episode.docked else FAILING, commands)
    yield greedy
    yield simulation.run(AT_START, np.zeros((1, 2)))
    reached = greedy.intermediate_step
    if reached is not None and (loitering := loiter_before_intermediate(simulation, commands, reached)):
        yield loitering
    limits = scenario.vessel.command_limit
    constant = [
        simulation.run(name, limits * [[propeller, rudder]]) for name, propeller, rudder in CONSTANT_COMMANDS
    ]
    yield from sorted(constant, key=lambda behavior: len(behavior.statuses))


def loiter_before_intermediate(
    simulation: BehaviorSimulation, commands: Floats, reached: int
) -> Behavior | None:
    """Approach the intermediate pose and stop the propeller just early enough not to reach it.

    Args:
        commands: (k, 2) of an episode that reaches the pose in step `reached`.

    Returns:
        None if the boat drifts through the pose or collides no matter where the propeller stops.
    """
    stops = (
        simulation.run(BEFORE_INTERMEDIATE, np.concatenate([commands[:step], np.zeros((1, 2))]))
        for step in range(reached, -1, -1)
    )
    return next((b for b in stops if b.intermediate_step is None and b.outcome == "timeout"), None)


def evaluate_behaviors(
    scenario: Scenario, unit_m: float, simulated: Sequence[Behavior]
) -> Iterator[dict[str, Value]]:
    """Yield a row per behavior: its discounted return and the contribution of each reward term.

    `intermediate_discount` is what a reward of one for the intermediate pose adds to the return.
    """
    gamma = scenario.training.gamma
    reward = scenario.reward.model_copy(update={"distance_unit_m": unit_m})
    function, intermediate = RewardFunction(reward), RewardFunction(_only_intermediate_term(reward))
    for behavior in simulated:
        terms = [function(status)[1] for status in behavior.statuses]
        sums = {name: discounted([term[name][0] for term in terms], gamma) for name in function.names}
        unit_rewards = [intermediate(status)[0][0] for status in behavior.statuses]
        yield {
            "behavior": behavior.name,
            "outcome": behavior.outcome,
            "steps": len(behavior.statuses),
            "time_s": len(behavior.statuses) * scenario.vessel.control_period_s,
            "distance_unit_m": unit_m,
            "return": sum(sums.values()),
            "intermediate_discount": discounted(unit_rewards, gamma),
            **{f"reward_{name}": value for name, value in sums.items()},
        }


def discounted(rewards: Sequence[float], gamma: float) -> float:
    """Return the sum of gamma^t times the reward of step t, from t = 0."""
    return float(np.power(gamma, np.arange(len(rewards))) @ np.asarray(rewards, float))


def _only_intermediate_term(reward: Reward) -> Reward:
    """Return the reward with a weight of one for the intermediate pose, and nothing else."""
    terms = [term for term in reward.terms if REWARD_TERMS.get(term.term).kind == "intermediate"]
    return reward.model_copy(update={"terms": tuple(t.model_copy(update={"weight": 1.0}) for t in terms)})
