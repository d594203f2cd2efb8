"""Policies: from a batch of observations to a batch of actions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.dqn import passes
from dockctl.agents.dqn.network import DuelingQNetwork

Actions = NDArray[np.int64]
Info = Mapping[str, Any]


class Policy(Protocol):
    """Chooses the actions of n boats; it may keep state from step to step."""

    def reset(self, rows: NDArray[np.int64], info: Info) -> None:
        """Forget the episodes of the boats `rows` (k,), which begin new ones; `info` is that of the reset."""
        ...

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action for each boat.

        Args:
            observation: (n, observation_size).
            info: of the same step, with n rows under each key.
        """
        ...


class GreedyPolicy:
    """The action of the highest value, (n, observation_size) -> (n,), of the network as it is at the call.

    Raises:
        ValueError: the observations have another shape.
    """

    def __init__(self, network: DuelingQNetwork) -> None:
        passes.hold_to_one_thread()
        self.network = network
        self._layers = network.layers(network.flat.numpy())

    def reset(self, rows: NDArray[np.int64], info: Info) -> None:
        """Do nothing: the policy keeps no state."""

    def act(self, observation: NDArray[Any], info: Info) -> Actions:
        """Return the action of the highest value for each boat; see `Policy`."""
        rows = np.ascontiguousarray(observation, np.float32)
        if rows.shape[1:] != (self.network.observation_size,):
            expected = f"(n, {self.network.observation_size})"
            raise ValueError(f"the policy takes observations of shape {expected}, not {rows.shape}")
        return passes.greedy_action(self._layers, rows)


class EpsilonGreedyPolicy:
    """A random action with the given probability, otherwise the greedy one."""

    def __init__(self, network: DuelingQNetwork, rng: np.random.Generator) -> None:
        self.greedy = GreedyPolicy(network)
        self.rng = rng

    def __call__(self, observation: NDArray[Any], epsilon: float) -> Actions:
        boats = len(observation)
        explore = self.rng.random(boats) < epsilon
        random_action = self.rng.integers(self.greedy.network.actions, size=boats)
        return np.where(explore, random_action, self.greedy.act(observation, {}))
