"""How far a training is, and whether it has done what it is for."""

from __future__ import annotations

from dataclasses import dataclass, field

from dockctl.analysis.learning import RECENT
from dockctl.scenarios.training import StopRule, Training

REASONS = {
    "mastered": "The task is mastered",
    "episodes": "The last episode is sailed",
    "steps": "The last step is made",
    "interrupted": "Interrupted",
}
"""Why a training ends."""


@dataclass
class Progress:
    """Counters of a training; everything here goes into its last checkpoint.

    Attributes:
        env_steps, updates, episodes: how many there were.
        outcomes: finished training episodes by outcome.
        recent: whether each of the latest training episodes docked, and whether it began at an initial pose.
        best: episodes docked and mean return of the best greedy evaluation.
        evaluated_at: environment steps at the latest greedy evaluation, 0 before the first.
        evaluation_docked, evaluation_episodes: what that evaluation came to.
        wall_s: seconds spent training.
        epsilon, loss, learning_rate: latest values, for display.
    """

    env_steps: int = 0
    updates: int = 0
    episodes: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)
    recent: list[list[bool]] = field(default_factory=list)
    best: list[float] | None = None
    evaluated_at: int = 0
    evaluation_docked: int = 0
    evaluation_episodes: int = 0
    wall_s: float = 0.0
    epsilon: float = 1.0
    loss: float | None = None
    learning_rate: float | None = None

    def count_episode(self, outcome: str, from_initial_pose: bool, keep: int) -> None:
        """Count a finished training episode; `keep` is how many of the latest are remembered."""
        self.episodes += 1
        self.outcomes[outcome] = self.outcomes.get(outcome, 0) + 1
        self.recent = [*self.recent[-(keep - 1) :], [outcome == "docked", from_initial_pose]][-keep:]

    @property
    def recent_docked(self) -> int:
        """Docked among the last 100 training episodes."""
        return sum(docked for docked, _ in self.recent[-RECENT:])

    def mastered(self, rule: StopRule) -> bool:
        """Whether the stop rule holds.

        Enough of the last episodes docked, exploring ones and those from the initial poses taken apart as
        well as together, and the greedy policy docked from every evaluation pose when last asked.
        """
        recent = self.recent[-rule.episodes :]
        own = [docked for docked, from_initial_pose in recent if from_initial_pose]
        return (
            len(recent) == rule.episodes
            and sum(docked for docked, _ in recent) >= rule.docked
            and sum(own) * rule.episodes >= rule.docked * len(own)
            and 0 < self.evaluation_episodes == self.evaluation_docked
        )

    def reason_to_stop(self, training: Training) -> str | None:
        """Why the training is over, a key of `REASONS`, or None while it is not."""
        if training.stop is not None and self.mastered(training.stop):
            return "mastered"
        if training.max_episodes is not None and self.episodes >= training.max_episodes:
            return "episodes"
        if self.env_steps >= training.total_steps:
            return "steps"
        return None
