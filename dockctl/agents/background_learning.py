"""Calls an algorithm's `learn` in the background, while boats move or policies are evaluated."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

from numpy.typing import NDArray

from dockctl.agents.interface import Algorithm, Metrics, Overlapping
from dockctl.agents.progress import Progress
from dockctl.compute import begin_background, drop_background, in_background
from dockctl.scenarios.training import Training

MOST_AHEAD = 100
"""Updates are made ahead for at most one in so many of all steps."""
SCANS = 5
"""Scans of one boat in an evaluation, which take about as long as the updates of one step of all boats."""


class Learned(NamedTuple):
    """A call to `learn`: environment steps and observation before it, and the metrics of its updates."""

    env_steps: int
    observation: NDArray[Any] | None
    metrics: list[Metrics]


class BackgroundLearning:
    """Makes the updates that are due, and those of the next steps while a policy is evaluated.

    Afterwards each step makes three quarters of its updates until the steps have caught up.

    Args:
        algorithm: learns in another thread, one call after another.
        training: number of boats and of steps, and when updates are due.
    """

    def __init__(self, algorithm: Algorithm, training: Training) -> None:
        self._algorithm, self._training = algorithm, training
        self.overlaps = isinstance(algorithm, Overlapping) and algorithm.acts_while_learning
        self._calls: deque[tuple[int, NDArray[Any] | None, Future[list[Metrics]]]] = deque()

    def step(self, progress: Progress, observation: NDArray[Any]) -> None:
        """Make the updates due now, from what is stored now; they begin after the next scan."""
        fewer = self._training.boats * 3 // 4
        due_at = self._due_at(progress, max(progress.env_steps, progress.learned_steps + fewer))
        progress.learned_steps = due_at
        self._call(progress, observation, partial(list[Metrics], self._algorithm.learn(due_at)))
        if not self.overlaps:
            begin_background()

    @contextmanager
    def ahead(self, progress: Progress, observation: NDArray[Any] | None) -> Iterator[None]:
        """Evaluate policies in the block, and make the updates of the next steps meanwhile.

        Nothing is stored meanwhile. The number of scans in the block determines the number of updates.
        """
        boats, steps = self._training.boats, 0
        if self.overlaps and progress.reached_limit(self._training) is None:
            steps = self._training.total_steps // MOST_AHEAD // boats

        def learn(due_at: int) -> list[Metrics]:  # draws the transitions only then
            return list(self._algorithm.learn(due_at))

        due_at = [self._due_at(progress, progress.env_steps + (i + 1) * boats) for i in range(steps)]
        for due in due_at:
            self._call(progress, observation, partial(learn, due), after=SCANS)
        try:
            yield
        finally:
            for _ in range(drop_background()):
                self._calls.pop()
                due_at.pop()
            if due_at:
                progress.learned_steps = due_at[-1]

    def finish(self) -> None:
        """Wait for all updates."""
        begin_background()
        wait([metrics for *_, metrics in self._calls])

    def forget(self) -> None:
        """Wait for all updates, and forget their metrics."""
        self.finish()
        self._calls.clear()

    def learned(self, *, later: int = 0) -> Iterator[Learned]:
        """Wait for all calls but the latest `later`, and yield them."""
        begin_background(later=later)
        if not later:
            self.finish()
        while len(self._calls) > later:
            env_steps, observation, metrics = self._calls.popleft()
            yield Learned(env_steps, observation, metrics.result())

    def _due_at(self, progress: Progress, steps: int) -> int:
        """Return after how many environment steps the next updates are due; that may be later than now."""
        return min(max(steps, progress.learned_steps), self._training.total_steps)

    def _call(
        self,
        progress: Progress,
        observation: NDArray[Any] | None,
        learn: Callable[[], list[Metrics]],
        *,
        after: int = 1,
    ) -> None:
        self._calls.append((progress.env_steps, observation, in_background(learn, after=after)))
