"""The dueling network that is trained (thesis section 3.2.5, Fig. 3.12; eq. 2.56)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from dockctl.dueling import advantage_units

FIRST_LAYER = "shared.0.weight"
"""Name of the weights of the first layer, (width, observation_size)."""


class DuelingQNetwork(nn.Module):
    """Action values of a batch of observations, ``Q = V + A - mean A`` (eq. 2.56).

    Shared ReLU layers feed two streams with one hidden layer each. Its width is that of the last shared layer
    in the value stream, and `advantage_units` in the advantage stream.

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
        units = advantage_units(actions)
        self.advantage = nn.Sequential(nn.Linear(width, units), nn.ReLU(), nn.Linear(units, actions))
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


def widened(given: NDArray[np.float32], wide: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return `wide` with `given` as its first rows and columns, and zeros to the right of them.

    With all tensors of a network widened like this, the network computes the same function: the old units do
    not depend on the added ones, which keep their weights from `wide` (function-preserving widening, after
    Net2Net, Chen et al. 2016).

    Args:
        given: weights (outputs, inputs) or biases (outputs,) of a layer.
        wide: those of a layer with at least as many outputs and inputs.
    """
    result = wide.copy()
    result[: len(given)] = 0
    result[tuple(map(slice, given.shape))] = given
    return result
