"""Starts that are tried again because their episode failed."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from dockctl.geometry import Bools, Ints
from dockctl.runs.tables import EXPLORING, RETRIED
from dockctl.sim.starts import Start

KEPT = 16
"""Maximum number of failed starts kept for each boat; a new one then replaces the oldest."""


class FailedStarts:
    """The starts of failed episodes, a queue for each boat.

    Easy starts are soon learned, and then nearly all training episodes repeat them. Retries keep up the
    share of episodes with hard starts (a form of prioritized level replay, Jiang, Grefenstette and
    Rocktäschel 2021). Exploring starts are not kept, because docking is impossible from some of them.

    Args:
        boats: number of boats.
        fraction: fraction of a boat's starts that are taken from its queue, if it is not empty; if 0, the
            queues stay empty.
    """

    def __init__(self, boats: int, fraction: float) -> None:
        self._fraction = fraction
        self._current: list[Start | None] = [None] * boats
        self._queues = [deque[Start](maxlen=KEPT) for _ in range(boats)]

    def begin(self, boats: Ints, starts: Sequence[Start]) -> None:
        """Record the starts of the new episodes of these boats (k,)."""
        for boat, start in zip(boats, starts, strict=True):
            self._current[boat] = start

    def end(self, failed: Bools) -> None:
        """Keep the starts of the boats (n,) whose episode failed."""
        for boat in np.flatnonzero(failed):
            start = self._current[boat]
            if self._fraction and start is not None and start.kind != EXPLORING:
                self._queues[boat].append(replace(start, kind=RETRIED))

    def take(self, boat: int, rng: np.random.Generator) -> Start | None:
        """Remove and return the oldest failed start; None if the next one is to be drawn."""
        queue = self._queues[boat]
        return queue.popleft() if queue and rng.random() < self._fraction else None

    def state(self) -> dict[str, Any] | None:
        """Return all starts as dictionaries; None if the fraction is 0."""
        if not self._fraction:
            return None
        return {
            "current": [start and asdict(start) for start in self._current],
            "queues": [[asdict(start) for start in queue] for queue in self._queues],
        }

    def restore(self, state: dict[str, Any] | None) -> None:
        """Continue with what `state` returned.

        Raises:
            KeyError, TypeError, ValueError: it is not the state of this number of boats.
        """
        if not self._fraction:
            return
        if state is None:
            raise ValueError("a state without failed starts")
        queues = [[Start(**start) for start in queue] for queue in state["queues"]]
        if not len(queues) == len(state["current"]) == len(self._queues):
            raise ValueError("a different number of boats")
        self._current = [start and Start(**start) for start in state["current"]]
        self._queues = [deque(queue, maxlen=KEPT) for queue in queues]
