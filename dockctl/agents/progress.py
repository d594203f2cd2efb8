"""Progress of a training run: counters, the stop rule, and the rows of its tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any

import numpy as np
import pydantic.dataclasses
from numpy.typing import NDArray
from pydantic import Field, NonNegativeInt

from dockctl.agents.interface import Info, Metrics, Tensors
from dockctl.runs.tables import RECENT, Value
from dockctl.scenarios.training import StopRule, Training

REASONS = {
    "mastered": "The stop rule is met",
    "episodes": "The episode limit is reached",
    "steps": "The step limit is reached",
    "interrupted": "Interrupted",
    "diverged": "Training diverged",
}
"""Why a training run ended."""


@pydantic.dataclasses.dataclass
class Progress:
    """Counters of a training run, saved in its last checkpoint; types are checked on loading.

    Attributes:
        env_steps: environment steps, summed over all boats.
        updates: gradient steps.
        learned_steps: environment steps for which all updates due have been made or begun; they may be ahead
            of `env_steps`.
        episodes: finished training episodes.
        outcomes: finished training episodes by outcome; empty if the environment reports none.
        recent: for each of the latest training episodes, whether it docked and whether it started at an
            initial pose.
        best: docked episodes, episodes and mean return of the best validation.
        validated_at: environment steps at the latest validation, 0 before the first.
        validation_docked, validation_episodes: result of that validation.
        evaluated_at: environment steps at the latest evaluation, 0 before the first.
        evaluation_docked, evaluation_episodes: result of that evaluation.
        rollbacks: how many times training returned to a checkpoint because it diverged.
        wall_s: seconds of training.
        epsilon, loss: latest values, for display.
    """

    env_steps: NonNegativeInt = 0
    updates: NonNegativeInt = 0
    learned_steps: NonNegativeInt = 0
    episodes: NonNegativeInt = 0
    outcomes: dict[str, int] = field(default_factory=dict)
    recent: list[Annotated[list[bool], Field(min_length=2, max_length=2)]] = field(default_factory=list)
    best: Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    validated_at: NonNegativeInt = 0
    validation_docked: NonNegativeInt = 0
    validation_episodes: NonNegativeInt = 0
    evaluated_at: NonNegativeInt = 0
    evaluation_docked: NonNegativeInt = 0
    evaluation_episodes: NonNegativeInt = 0
    rollbacks: NonNegativeInt = 0
    wall_s: float = 0.0
    epsilon: float | None = None
    loss: float | None = None

    def count_episode(self, outcome: str, from_initial_pose: bool, window: int) -> None:
        """Count a finished training episode, and keep the latest `window` of them for the stop rule."""
        self.episodes += 1
        if outcome:
            self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1
        self.recent = [*self.recent, [outcome == "docked", from_initial_pose]][-window:]

    def crossed(self, every: int, *, since: int) -> bool:
        """Return whether a multiple of `every` environment steps was passed after `since`."""
        return self.env_steps // every > since // every

    @property
    def recent_docked(self) -> int:
        """Number of docked episodes among the last `RECENT` training episodes."""
        return sum(docked for docked, _ in self.recent[-RECENT:])

    def mastered(self, rule: StopRule) -> bool:
        """Return whether the stop rule is met, apart from the validation.

        It requires that enough of the last episodes docked, both of all episodes and of those from the
        initial poses, and that the greedy policy docked from every start of the latest evaluation.
        """
        if not 0 < self.evaluation_episodes == self.evaluation_docked:
            return False
        recent = self.recent[-rule.episodes :]
        own = [docked for docked, from_initial_pose in recent if from_initial_pose]
        return (
            len(recent) == rule.episodes
            and sum(docked for docked, _ in recent) >= rule.docked
            and sum(own) * rule.episodes >= rule.docked * len(own)
        )

    def validated(self, rule: StopRule) -> bool:
        """Return whether the share docked of the latest validation also meets the rule."""
        return self.validation_docked * rule.episodes >= rule.docked * self.validation_episodes > 0

    def reached_limit(self, training: Training) -> str | None:
        """Return the limit that training has reached, a key of `REASONS`, or None."""
        if training.max_episodes is not None and self.episodes >= training.max_episodes:
            return "episodes"
        if self.env_steps >= training.total_steps:
            return "steps"
        return None


class EpisodeRecorder:
    """Sums the rewards and counts the steps of every boat until its episode ends."""

    def __init__(self, boats: int) -> None:
        self._boats = boats
        self._steps = np.zeros(boats, np.int64)
        self._return = np.zeros(boats)
        self._terms: dict[str, NDArray[np.float64]] = {}

    def add(self, reward: NDArray[Any], info: Info, done: NDArray[np.bool_]) -> list[dict[str, Value]]:
        """Add one step of all boats, and return a row for each episode that ended.

        Args:
            reward: (n,).
            info: after the step and before any reset; missing keys give empty cells.
            done: (n,).
        """
        self._steps += 1
        self._return += reward
        for name, value in info.get("reward_terms", {}).items():
            if not name.startswith("_"):
                self._terms.setdefault(name, np.zeros(self._boats))[:] += value
        rows = [self._row(int(boat), info) for boat in np.flatnonzero(done)]
        for sums in (self._steps, self._return, *self._terms.values()):
            sums[done] = 0
        return rows

    def state(self) -> tuple[dict[str, NDArray[Any]], list[str]]:
        """Return the sums of the unfinished episodes, and the names of the reward terms in their order."""
        terms = np.array([*self._terms.values()]).reshape(-1, self._boats)
        return {"steps": self._steps, "return": self._return, "terms": terms}, [*self._terms]

    def restore(self, sums: Tensors, terms: Sequence[str]) -> None:
        """Continue the episodes of which `state` returned the sums.

        Raises:
            ValueError: the number of boats differs.
        """
        self._steps[:], self._return[:] = sums["steps"], sums["return"]
        totals = sums["terms"].astype(float).reshape(len(terms), self._boats)
        self._terms = dict(zip(terms, totals, strict=True))

    def _row(self, boat: int, info: Info) -> dict[str, Value]:
        row: dict[str, Value] = {
            "boat": boat,
            "return": float(self._return[boat]),
            "steps": int(self._steps[boat]),
        }
        for name in ("start_kind", "outcome", "collided_with"):
            row[name] = str(info[name][boat] or "") if name in info else ""
        for name, number in (("start_index", int), ("phase", int), ("distance_m", float)):
            if name in info:
                row[name] = number(info[name][boat])
        if "heading_error_rad" in info:
            row["heading_error_deg"] = math.degrees(info["heading_error_rad"][boat])
        if "velocity" in info:
            row["speed_mps"] = math.hypot(*info["velocity"][boat][:2])
        return row | {f"reward_{name}": float(total[boat]) for name, total in self._terms.items()}


class UpdateRecorder:
    """Averages the metrics of `stride` calls to `add` into a row."""

    def __init__(self, stride: int) -> None:
        self._stride = stride
        self._metrics: list[Metrics] = []

    def state(self) -> list[dict[str, str]]:
        """Return the metrics since the last row, as text because JSON has no NaN."""
        return [{name: repr(value) for name, value in metrics.items()} for metrics in self._metrics]

    def restore(self, state: Sequence[Mapping[str, str]]) -> None:
        """Continue with what `state` returned."""
        self._metrics = [{name: float(value) for name, value in metrics.items()} for metrics in state]

    def add(self, metrics: Metrics) -> dict[str, Value] | None:
        """Add metrics, and return the means since the last row when a row is due."""
        self._metrics.append({name: float(value) for name, value in metrics.items()})
        if len(self._metrics) < self._stride:
            return None
        names = dict.fromkeys(name for each in self._metrics for name in each)  # some may be in a few only
        means = {name: float(np.mean([m[name] for m in self._metrics if name in m])) for name in names}
        self._metrics.clear()
        return dict(means)
