"""Measure how long each part of a decision takes, in greedy episodes."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy, QPolicy
from dockctl.analysis.latency import OPTIONAL, PARTS, summarize
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Rollout, controlled
from dockctl.evaluation.starts import evaluation_starts
from dockctl.geometry import Ints
from dockctl.runs.provenance import hardware
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import Start


@dataclass(frozen=True, eq=False)
class Latency:
    """Times of decisions.

    Attributes:
        overrides: changed values of the scenario, ``key=value``.
        samples: one row per decision, columns `dockctl.analysis.latency.PARTS` [ms].
    """

    policy: LoadedPolicy
    scenario: Scenario
    overrides: tuple[str, ...]
    samples: pd.DataFrame

    @property
    def subject(self) -> str:
        return ", ".join([f"{self.policy.caption}; scenario {self.scenario.name}", *self.overrides])

    @property
    def control_period_ms(self) -> float:
        return 1000 * self.scenario.vessel.control_period_s

    @property
    def summary(self) -> dict[str, dict[str, float]]:
        """Statistics of each part [ms]."""
        return summarize(self.samples)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``latency.json``."""
        return {
            "subject": self.subject,
            "policy": self.policy.facts(),
            "set": list(self.overrides),
            "decisions": len(self.samples),
            "milliseconds": {PARTS[part]: values for part, values in self.summary.items()},
            "control_period_ms": self.control_period_ms,
            "hardware": hardware(),
        }


def latency(
    policy: str | Path | LoadedPolicy | None = None,
    scenario: str | Path | None = None,
    decisions: int = 500,
    *,
    overrides: Sequence[str] = (),
) -> Latency:
    """Time at least `decisions` decisions of one boat.

    Args:
        policy: see `dockctl.evaluation.loading.load_policy`; the latest run by default.
        scenario: file or name; the policy's own by default.
        overrides: changed values of the scenario, ``key=value``.

    Raises:
        DockctlError: there is no such policy or scenario, or they do not match.
    """
    loaded_policy = load_policy(policy)
    loaded = loaded_policy.scenario(scenario, overrides)
    env = Rollout(loaded).env()
    samples = time_decisions(env, loaded_policy.make(env), decisions)
    return Latency(loaded_policy, loaded.scenario, tuple(overrides), samples)


def time_decisions(env: DockingVectorEnv, policy: Policy, decisions: int) -> pd.DataFrame:
    """Run complete greedy episodes of one boat until at least `decisions` decisions are timed.

    The parts of a decision are the scan, the observation, the forward pass with the action selection, and
    what the supervisor and the planner of the scenario do. Each episode runs twice and is timed the second
    time: the first one compiles code, and builds the tables of its harbor.

    Returns:
        one row per decision, columns `dockctl.analysis.latency.PARTS` [ms].

    Raises:
        DockctlError: `decisions` is less than 1.
    """
    if decisions < 1:
        raise DockctlError(f"{decisions} decisions: expected at least 1", code="out_of_range")
    timed = _Timed(policy)
    whole = controlled(timed, env)
    starts = itertools.cycle(evaluation_starts(env.scenario, env.worlds))
    rows: list[tuple[float, ...]] = []
    while len(rows) < decisions:
        start = next(starts)
        deque(_episode(env, whole, timed, start), maxlen=0)
        rows += _episode(env, whole, timed, start)
    samples = pd.DataFrame(1000 * np.array(rows), columns=list(PARTS))
    if whole is timed:
        samples["forward_ms"] += samples.pop(OPTIONAL)  # the time of calls
    return samples


def _episode(
    env: DockingVectorEnv, whole: Policy, policy: _Timed, start: Start
) -> Iterator[tuple[float, ...]]:
    """Run an episode of one boat; yield the times of each decision, in the order of `PARTS` [s].

    Args:
        whole: `policy` with supervisor and planner.
    """
    _, info = env.reset(seed=0, options={"starts": [start]})
    whole.reset(np.array([0]), info)
    ended = False
    while not ended:
        begin = perf_counter()
        ranges = env.simulator.scan()
        scanned = perf_counter()
        observation = env.observe(ranges)
        observed = perf_counter()
        action = whole.act(observation, info)
        done = perf_counter()
        control = done - observed - policy.seconds
        yield scanned - begin, observed - scanned, policy.seconds, control, done - begin
        _, _, terminated, truncated, info = env.step(action)
        ended = bool(terminated[0] or truncated[0])


class _Timed(Policy):
    """Runs a policy, and measures how long it takes to act.

    Attributes:
        seconds: time of the latest `act`.
    """

    def __init__(self, policy: Policy) -> None:
        self._policy, self.seconds = policy, 0.0
        if isinstance(policy, QPolicy):  # a supervisor needs the values, and runs no other policies
            self.q_values = policy.q_values

    def reset(self, rows: Ints, info: Info) -> None:
        self._policy.reset(rows, info)

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        begin = perf_counter()
        action = self._policy.act(observation, info)
        self.seconds = perf_counter() - begin
        return action
