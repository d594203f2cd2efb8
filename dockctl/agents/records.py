"""Rows of the tables of a run, collected step by step."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.autoreset import Info
from dockctl.agents.dqn.learner import UpdateMetrics
from dockctl.runs.tables import Value


class EpisodeRecorder:
    """Sums rewards and counts steps of every boat until its episode ends."""

    def __init__(self, boats: int) -> None:
        self._boats = boats
        self._steps = np.zeros(boats, np.int64)
        self._return = np.zeros(boats)
        self._terms: dict[str, NDArray[np.float64]] = {}

    def add(self, reward: NDArray[Any], info: Info, done: NDArray[np.bool_]) -> list[dict[str, Value]]:
        """Take one step of all boats (`info` settled) and return a row for each episode that ended."""
        self._steps += 1
        self._return += reward
        for name, value in info.get("reward_terms", {}).items():
            if not name.startswith("_"):
                self._terms.setdefault(name, np.zeros(self._boats))[:] += value
        rows = [self._row(int(boat), info) for boat in np.flatnonzero(done)]
        for sums in (self._steps, self._return, *self._terms.values()):
            sums[done] = 0
        return rows

    def _row(self, boat: int, info: Info) -> dict[str, Value]:
        u, v, _ = info["velocity"][boat]
        return {
            "boat": boat,
            "start_kind": str(info["start_kind"][boat]),
            "start_index": int(info["start_index"][boat]),
            "return": float(self._return[boat]),
            "steps": int(self._steps[boat]),
            "outcome": str(info["outcome"][boat]),
            "collided_with": str(info["collided_with"][boat] or ""),
            "phase": int(info["phase"][boat]),
            "distance_m": float(info["distance_m"][boat]),
            "heading_error_deg": math.degrees(info["heading_error_rad"][boat]),
            "speed_mps": math.hypot(u, v),
            **{f"reward_{name}": float(total[boat]) for name, total in self._terms.items()},
        }


class UpdateRecorder:
    """Averages what the updates saw; every `stride`-th update gives a row."""

    def __init__(self, stride: int) -> None:
        self._stride = stride
        self._seen: list[UpdateMetrics] = []

    def add(self, metrics: UpdateMetrics) -> dict[str, Value] | None:
        """Take one update and return the means since the last row when one is due."""
        self._seen.append(metrics)
        if len(self._seen) < self._stride:
            return None
        means = np.mean(self._seen, axis=0)
        self._seen.clear()
        return {name: float(mean) for name, mean in zip(UpdateMetrics._fields, means, strict=True)}
