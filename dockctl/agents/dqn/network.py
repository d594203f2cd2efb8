"""The dueling network (thesis section 3.2.5, Fig. 3.12; eq. 2.56)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Floats = NDArray[np.float32]


class Layer(NamedTuple):
    """Weight (outputs, inputs) and bias (outputs,) of ``x W^T + b``."""

    weight: Floats
    bias: Floats


class Layers(NamedTuple):
    """The matrices of a dueling network, views of one vector, as compiled code takes them.

    Attributes:
        hidden: the shared layers, then the first layers of both streams as one of `split` + actions outputs.
        value, advantage: the last layers of the streams.
        split: outputs of the last hidden layer that feed the value; the others feed the advantage.
    """

    hidden: tuple[Layer, ...]
    value: Layer
    advantage: Layer
    split: int


class DuelingQNetwork(nn.Module):
    """Action values of a batch of observations, ``Q = V + A - mean A`` (eq. 2.56).

    Shared ReLU layers feed two streams of one hidden layer each: as wide as the last shared layer
    for the value, as wide as the number of actions for the advantage.

    All the parameters are views of one vector, `flat`, and their gradients of one vector,
    `flat.grad`: clipping, the optimizer's step and the target copy are single operations. What runs
    often is compiled and works on the `layers` of that vector; this module with torch's autograd is what it
    must equal.

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
        self.observation_size, self.actions, self.hidden_sizes = (
            observation_size,
            actions,
            tuple(hidden_sizes),
        )
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
        self.flat = self._flatten()

    def _flatten(self) -> Tensor:
        """Move the parameters and their gradients into two vectors, of which they become views."""
        parameters = self._in_order()
        flat = torch.cat([parameter.detach().reshape(-1) for parameter in parameters])
        flat.grad = torch.zeros_like(flat)
        start = 0
        for parameter in parameters:
            end = start + parameter.numel()
            parameter.data = flat[start:end].view_as(parameter)
            parameter.grad = flat.grad[start:end].view_as(parameter)
            start = end
        return flat

    def _in_order(self) -> list[Tensor]:
        """The parameters as they follow in `flat`: weights side by side where `layers` makes one of two."""
        value_in, value_bias, *value = self.value.parameters()
        advantage_in, advantage_bias, *advantage = self.advantage.parameters()
        streams = [value_in, advantage_in, value_bias, advantage_bias]
        return [*self.shared.parameters(), *streams, *value, *advantage]

    def layers(self, vector: Floats) -> Layers:
        """The matrices as views of a vector of parameters or gradients that is laid out as `flat`."""
        width, actions = self.hidden_sizes[-1], self.actions
        sizes = [*pairwise((self.observation_size, *self.hidden_sizes, width + actions))]
        sizes += [(width, 1), (actions, actions)]
        lengths = [length for inputs, outputs in sizes for length in (inputs * outputs, outputs)]
        parts = iter(np.split(vector, np.cumsum(lengths)[:-1]))
        layers = [Layer(next(parts).reshape(outputs, inputs), next(parts)) for inputs, outputs in sizes]
        *hidden, value, advantage = layers
        return Layers(tuple(hidden), value, advantage, split=width)

    def copy_on(self, device: torch.device) -> DuelingQNetwork:
        """Return a network of the same parameters on `device`."""
        copy = DuelingQNetwork(self.observation_size, self.actions, self.hidden_sizes).to(device)
        copy.flat = copy._flatten()
        copy.flat.copy_(self.flat)
        return copy

    def forward(self, observation: Tensor) -> Tensor:
        """(n, observation_size) -> (n, actions)."""
        features = self.shared(observation)
        value, advantage = self.value(features), self.advantage(features)
        return torch.as_tensor(value + advantage - advantage.mean(dim=1, keepdim=True))
