"""The greedy policy of a dueling network, or of an ensemble of them, without torch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy, Tensors
from dockctl.dueling import Ensemble


class GreedyPolicy(Policy):
    """Chooses the action with the highest value; with hysteresis, it may keep the last action.

    Args:
        tensors: of the networks; see `dockctl.dueling`.

    Raises:
        KeyError, ValueError: they are not those of dueling networks.
    """

    def __init__(self, tensors: Tensors) -> None:
        self._networks = Ensemble.of(tensors)

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[np.int64]:
        """Return the action for each boat; see `Policy`.

        Raises:
            ValueError: see `q_values`.
        """
        values = self.q_values(observation)
        return self._networks.greedy(observation.astype(np.float32, copy=False), values)

    def q_values(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """Return the values of all actions, (n, observation_size) -> (n, actions).

        Raises:
            ValueError: `observation` is not (n, observation_size).
        """
        size, _ = self._networks.sizes
        if observation.ndim != 2 or observation.shape[1] != size:
            expected = f"(n, {size})"
            raise ValueError(f"the policy takes observations of shape {expected}, not {observation.shape}")
        return self._networks.q_values(observation.astype(np.float32, copy=False))
