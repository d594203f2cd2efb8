"""The dueling network (thesis section 3.2.5, Fig. 3.12; eq. 2.56) and its greedy policy."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from dockctl.agents.interface import Info, Policy

FIRST_LAYER = "shared.0.weight"
"""Name of the weights (width, observation_size) that observations are multiplied by."""


class DuelingQNetwork(nn.Module):
    """Action values of a batch of observations, ``Q = V + A - mean A`` (eq. 2.56).

    Shared ReLU layers feed two streams with one hidden layer each: for the value as wide as the last shared
    layer, for the advantage as wide as the number of actions.

    Args:
        observation_size: length of an observation.
        actions: number of discrete actions.
        hidden_sizes: widths of the shared layers.
        generator: draws the Glorot uniform weights; biases are zero.
    """

    def __init__(
        self,
        observation_size: int,
        actions: int,
        hidden_sizes: Sequence[int] = (256, 128, 64),
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.observation_size, self.actions = observation_size, actions
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise((observation_size, *hidden_sizes)):
            layers += [nn.Linear(inputs, outputs), nn.ReLU()]
        width = hidden_sizes[-1]
        self.shared = nn.Sequential(*layers)
        self.value = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 1))
        self.advantage = nn.Sequential(nn.Linear(width, actions), nn.ReLU(), nn.Linear(actions, actions))
        for name, parameter in self.named_parameters():
            if name.endswith("weight"):
                nn.init.xavier_uniform_(parameter, generator=generator)
            else:
                nn.init.zeros_(parameter)

    def forward(self, observation: Tensor) -> Tensor:
        """(n, observation_size) -> (n, actions)."""
        features = self.shared(observation)
        value, advantage = self.value(features), self.advantage(features)
        return torch.as_tensor(value + advantage - advantage.mean(dim=1, keepdim=True))


def network_size(observation_size: int, actions: int, hidden_sizes: Sequence[int]) -> tuple[int, int]:
    """Return the numbers of parameters and of layer outputs of a network, without allocating it."""
    with torch.device("meta"):
        network = DuelingQNetwork(observation_size, actions, hidden_sizes)
    outputs = sum(layer.out_features for layer in network.modules() if isinstance(layer, nn.Linear))
    return sum(parameter.numel() for parameter in network.parameters()), outputs


class GreedyPolicy(Policy):
    """The action of the highest value; the policy follows the network as it learns."""

    def __init__(self, network: DuelingQNetwork) -> None:
        torch.set_num_threads(1)  # the matrices are small, and the simulator uses the other cores
        self.network = network
        self._device = next(network.parameters()).device

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[np.int64]:
        """Return the action of the highest value for each boat; see `Policy`.

        Raises:
            ValueError: see `q_values`.
        """
        best: NDArray[np.int64] = self.q_values(observation).argmax(axis=1)
        return best

    @torch.inference_mode()
    def q_values(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """Return the values of all actions, (n, observation_size) -> (n, actions).

        Raises:
            ValueError: `observation` is not (n, observation_size).
        """
        if observation.ndim != 2 or observation.shape[1] != self.network.observation_size:
            expected = f"(n, {self.network.observation_size})"
            raise ValueError(f"the policy takes observations of shape {expected}, not {observation.shape}")
        values = self.network(torch.as_tensor(observation, dtype=torch.float32, device=self._device))
        return np.asarray(values.cpu())
