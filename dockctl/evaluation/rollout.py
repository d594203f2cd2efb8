"""Greedy episodes from given starts, and what they came to."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from dockctl.agents.autoreset import Info, settled_info
from dockctl.agents.policy import Policy
from dockctl.runs.tables import Value

Floats = NDArray[np.float64]


class Start(Protocol):
    """What the evaluator knows of a start; the environment, to which it is passed, knows more."""

    @property
    def eta(self) -> Floats: ...
    @property
    def kind(self) -> str: ...
    @property
    def berth(self) -> str: ...


LeastClearance = Callable[[Any, Floats], float]

RECORDED = ("pose", "velocity", "command", "distance_m", "heading_error_rad", "phase", "sector_ranges_m")
READ = (*RECORDED, "outcome", "collided_with")


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode and its course.

    Attributes:
        start: how it began.
        outcome: ``docked``, ``collision`` or ``timeout``.
        collided_with: name of what was hit, or empty.
        phase: 0 or 1, the phase in which it ended.
        total_reward: undiscounted sum of the rewards.
        course: arrays of steps + 1 rows by info key, and ``reward``; row 0 is the start.
        clearance_m: least distance between hull and harbor, NaN where it was not measured.
    """

    start: Start
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


def play(
    env: VectorEnv[Any, Any, Any],
    policy: Policy,
    starts: Sequence[Start],
    clearance: LeastClearance | None = None,
    *,
    seed: int = 0,
) -> list[Episode]:
    """Play one episode from each start, side by side; a boat that has ended takes the next start.

    Args:
        env: same-step autoreset; takes ``reset(options={"starts": n, "reset_mask": (n,)})``.
        policy: chooses the actions.
        starts: any number of them, k.
        clearance: of a start and the poses (m, 3) of the way from it, the least distance to the harbor [m].
        seed: of the environment.

    Returns:
        k episodes in the order of the starts.
    """
    boats = range(env.num_envs)
    assigned = list(boats)  # the start that each boat sails from; numbers past the last one are spare boats

    def following() -> list[Start]:
        return [starts[min(number, len(starts) - 1)] for number in assigned]

    observation, info = env.reset(seed=seed, options={"starts": following()})
    policy.reset(np.arange(env.num_envs), info)
    courses = [_Course(info, boat) for boat in boats]
    episodes: dict[int, Episode] = {}
    while len(episodes) < len(starts):
        observation, reward, terminated, truncated, info = env.step(policy.act(observation, info))
        done = terminated | truncated
        last = {key: np.array(value) for key, value in settled_info(info, done).items() if key in READ}
        for boat in boats:
            courses[boat].add(last, boat, float(reward[boat]))
        for boat in np.flatnonzero(done).tolist():
            if assigned[boat] < len(starts):
                start = starts[assigned[boat]]
                episodes[assigned[boat]] = courses[boat].episode(last, boat, start, clearance)
            assigned[boat] = max(assigned) + 1
        if done.any():
            observation, info = env.reset(options={"starts": following(), "reset_mask": done})
            policy.reset(np.flatnonzero(done), info)
            for boat in np.flatnonzero(done).tolist():
                courses[boat] = _Course(info, boat)
    return [episodes[index] for index in range(len(starts))]


class _Course:
    """What one boat does, step by step."""

    def __init__(self, info: Info, boat: int) -> None:
        self._records = {key: [np.array(info[key][boat])] for key in RECORDED}
        self._rewards = [0.0]

    def add(self, info: Info, boat: int, reward: float) -> None:
        for key, record in self._records.items():
            record.append(info[key][boat])
        self._rewards.append(reward)

    def episode(self, info: Info, boat: int, start: Start, clearance: LeastClearance | None) -> Episode:
        course = {key: np.stack(record) for key, record in self._records.items()}
        return Episode(
            start=start,
            outcome=str(info["outcome"][boat]),
            collided_with=str(info["collided_with"][boat] or ""),
            phase=int(course["phase"][-1]),
            total_reward=sum(self._rewards),
            course={**course, "reward": np.array(self._rewards)},
            clearance_m=math.nan if clearance is None else clearance(start, course["pose"]),
        )


def score(episodes: Sequence[Episode]) -> tuple[int, float]:
    """How policies are ranked: episodes docked, then mean return."""
    return sum(e.docked for e in episodes), float(np.mean([e.total_reward for e in episodes]))
