"""Measure how long each part of a decision takes, in greedy episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import pandas as pd

from dockctl.agents.interface import Policy
from dockctl.analysis.latency import PARTS, summarize
from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Rollout
from dockctl.evaluation.starts import evaluation_starts
from dockctl.runs.provenance import hardware
from dockctl.scenarios.schema import Scenario

WARM_UP = 20
"""First decisions, which are not counted: they compile code and fill tables and caches."""


@dataclass(frozen=True, eq=False)
class Latency:
    """Times of decisions.

    Attributes:
        samples: one row per decision, columns `dockctl.analysis.latency.PARTS` [ms].
    """

    policy: LoadedPolicy
    scenario: Scenario
    samples: pd.DataFrame

    @property
    def subject(self) -> str:
        return f"{self.policy.caption}; scenario {self.scenario.name}"

    @property
    def control_period_ms(self) -> float:
        return 1000 * self.scenario.vessel.control_period_s

    @property
    def summary(self) -> dict[str, dict[str, float]]:
        """Statistics of each part [ms]."""
        return summarize(self.samples)

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``latency.json``."""
        summary = self.summary
        return {
            "subject": self.subject,
            "policy": self.policy.facts(),
            "decisions": len(self.samples),
            "milliseconds": {name: summary[part] for part, name in PARTS.items()},
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
    return Latency(loaded_policy, loaded.scenario, samples)


def time_decisions(env: DockingVectorEnv, policy: Policy, decisions: int) -> pd.DataFrame:
    """Run complete greedy episodes of one boat until at least `decisions` decisions are timed.

    The parts of a decision are the scan, the observation, and the forward pass with the action selection.

    Returns:
        one row per decision, columns `dockctl.analysis.latency.PARTS` [ms].
    """
    scenario, simulator = env.scenario, env.simulator
    starts = evaluation_starts(scenario, env.worlds)
    rows: list[tuple[float, ...]] = []
    info: dict[str, Any] = {}
    episode, ended = 0, True
    while len(rows) < WARM_UP + decisions or not ended:
        if ended:
            _, info = env.reset(seed=0, options={"starts": [starts[episode % len(starts)]]})
            policy.reset(np.array([0]), info)
            episode += 1
        begin = perf_counter()
        ranges = simulator.scan()
        scanned = perf_counter()
        observation = env.observe(ranges)
        observed = perf_counter()
        action = policy.act(observation, info)
        done = perf_counter()
        rows.append((scanned - begin, observed - scanned, done - observed, done - begin))
        _, _, terminated, truncated, info = env.step(action)
        ended = bool(terminated[0] or truncated[0])
    return pd.DataFrame(1000 * np.array(rows[WARM_UP:]), columns=list(PARTS))
