"""Greedy episodes from given starts, and what they came to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from dockctl.agents.interface import settled_info
from dockctl.agents.policy import Policy
from dockctl.runs.tables import Value

Floats = NDArray[np.float64]
Clearance = Callable[[Floats], Floats]

RECORDED = ("pose", "velocity", "command", "distance_m", "heading_error_rad", "phase", "sector_ranges_m")


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode and its course.

    Attributes:
        start: x [m], y [m], heading [rad] at which it began.
        outcome: ``docked``, ``collision`` or ``timeout``.
        collided_with: name of what was hit, or empty.
        phase: 0 or 1, the phase in which it ended.
        total_reward: undiscounted sum of the rewards.
        course: arrays of steps + 1 rows by info key, and ``reward``; row 0 is the start.
        clearance_m: least distance between hull and harbor, NaN where it was not measured.
    """

    start: Floats
    outcome: str
    collided_with: str
    phase: int
    total_reward: float
    course: dict[str, NDArray[Any]]
    clearance_m: float = math.nan

    @property
    def docked(self) -> bool:
        return self.outcome == "docked"

    @property
    def steps(self) -> int:
        return len(self.course["reward"]) - 1

    @property
    def path_length_m(self) -> float:
        return float(np.hypot(*np.diff(self.course["pose"][:, :2], axis=0).T).sum())

    @property
    def control_changes(self) -> float:
        """Fraction of the steps whose propeller or rudder command differs from the step before."""
        commands = self.course["command"][1:]
        changed = (np.diff(commands, axis=0) != 0).any(axis=1)
        return float(changed.mean()) if len(changed) else 0.0

    def row(self) -> dict[str, Value]:
        """Columns `dockctl.runs.tables.EPISODE_RESULT`."""
        u, v, _ = self.course["velocity"][-1]
        return {
            "outcome": self.outcome,
            "collided_with": self.collided_with,
            "phase": self.phase,
            "return": self.total_reward,
            "steps": self.steps,
            "distance_m": float(self.course["distance_m"][-1]),
            "heading_error_deg": math.degrees(self.course["heading_error_rad"][-1]),
            "speed_mps": math.hypot(u, v),
            "path_length_m": self.path_length_m,
            "clearance_m": None if math.isnan(self.clearance_m) else self.clearance_m,
            "control_changes": self.control_changes,
        }


def play(env: VectorEnv[Any, Any, Any], policy: Policy, poses: Floats, clearance: Clearance | None = None) -> list[Episode]:
    """Play one episode from each pose, as many side by side as the environment has boats.

    Args:
        env: same-step autoreset; ``reset(options={"poses": (n, 3)})`` puts the boats where they are asked to be.
        policy: from observations to actions.
        poses: (k, 3) x [m], y [m], heading [rad], any k.
        clearance: (m, 3) poses -> (m,) distance between hull and harbor [m].
    """
    episodes: list[Episode] = []
    for first in range(0, len(poses), env.num_envs):
        episodes += _play_together(env, policy, poses[first : first + env.num_envs], clearance)
    return episodes


def _play_together(
    env: VectorEnv[Any, Any, Any], policy: Policy, poses: Floats, clearance: Clearance | None
) -> list[Episode]:
    wanted = len(poses)
    observation, info = env.reset(options={"poses": np.resize(poses, (env.num_envs, 3))})
    records = {key: [np.array(info[key])] for key in RECORDED}
    rewards = [np.zeros(env.num_envs)]
    endings: dict[int, tuple[int, str, str]] = {}
    while len(endings) < wanted:
        observation, reward, terminated, truncated, info = env.step(policy(observation))
        done = terminated | truncated
        info = settled_info(info, done)
        for key in RECORDED:
            records[key].append(np.array(info[key]))
        rewards.append(np.array(reward, np.float64))
        for boat in np.flatnonzero(done[:wanted]):
            ending = (len(rewards), str(info["outcome"][boat]), str(info["collided_with"][boat] or ""))
            endings.setdefault(int(boat), ending)
    courses = {**{key: np.stack(record) for key, record in records.items()}, "reward": np.stack(rewards)}
    episodes = []
    for boat, (rows, outcome, collided_with) in sorted(endings.items()):
        course = {key: values[:rows, boat] for key, values in courses.items()}
        least = math.nan if clearance is None else float(clearance(course["pose"]).min())
        total, phase = float(course["reward"].sum()), int(course["phase"][-1])
        episodes.append(Episode(poses[boat], outcome, collided_with, phase, total, course, least))
    return episodes


def wilson_interval(successes: int, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """95 % confidence interval of a success probability (Wilson 1927); (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    p, spread = successes / trials, z * z / trials
    center = (p + spread / 2) / (1 + spread)
    half = z * math.sqrt(p * (1 - p) / trials + spread / (4 * trials)) / (1 + spread)
    return max(0.0, center - half), min(1.0, center + half)


def score(episodes: Sequence[Episode]) -> tuple[int, float]:
    """How policies are ranked: episodes docked, then mean return."""
    return sum(e.docked for e in episodes), float(np.mean([e.total_reward for e in episodes]))
