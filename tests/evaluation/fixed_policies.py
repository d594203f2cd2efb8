"""Policies that do not look at what they observe; actions are those of the thesis' grid of 77."""

from __future__ import annotations

import numpy as np

from dockctl.agents.interface import Info, Policy

REST, AHEAD, ASTERN = 38, 73, 3
"""No thrust, full ahead and full astern, rudder amidships."""


class Rest(Policy):
    """Always without thrust."""

    def act(self, observation: np.ndarray, info: Info) -> np.ndarray:
        return np.full(len(observation), REST)


class Values(Policy):
    """Greedy with fixed values; in each step, those of one row of a table (k, 77), again and again."""

    def __init__(self, *values: np.ndarray) -> None:
        self.values, self.step = np.array(values, np.float32), 0

    def q_values(self, observation: np.ndarray) -> np.ndarray:
        return np.tile(self.values[(self.step - 1) % len(self.values)], (len(observation), 1))

    def act(self, observation: np.ndarray, info: Info) -> np.ndarray:
        self.step += 1
        return self.q_values(observation).argmax(axis=1)


def only(action: int) -> np.ndarray:
    """Return values (77,) of which one is above the others."""
    return np.eye(77)[action]
