"""Adam and RMSProp on one vector: what `torch.optim` computes, each step in one pass over memory."""

from __future__ import annotations

import math
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.dqn.network import Floats
from dockctl.agents.dqn.passes import compiled_freely

# Moments of silent units fade to denormal numbers, which take ten times as long; this is far below what the
# epsilons let through.
SILENT = np.float32(1e-30)


class Optimizer(Protocol):
    """Moves a vector of parameters along its gradient; `moments` is all that it remembers."""

    moments: dict[str, NDArray[Any]]

    def step(self, parameters: Floats, gradient: Floats, learning_rate: float) -> None: ...


class Adam:
    """Adam with the decay rates and the epsilon of its paper (Kingma and Ba 2015, algorithm 1)."""

    def __init__(self, parameters: Floats) -> None:
        first, second = np.zeros_like(parameters), np.zeros_like(parameters)
        self.moments: dict[str, NDArray[Any]] = {
            "first": first,
            "second": second,
            "steps": np.zeros((), np.float32),
        }

    def step(self, parameters: Floats, gradient: Floats, learning_rate: float) -> None:
        first, second, steps = self.moments.values()
        steps += 1
        rate, root = learning_rate / (1 - 0.9 ** float(steps)), 1 / math.sqrt(1 - 0.999 ** float(steps))
        _adam(parameters, gradient, first, second, np.float32(rate), np.float32(root))


@compiled_freely
def _adam(
    parameters: Floats, gradient: Floats, first: Floats, second: Floats, rate: np.float32, root: np.float32
) -> None:
    """Take a step; the biases of the moments are taken out by `rate` and `root`."""
    one, first_decay, second_decay = np.float32(1), np.float32(0.9), np.float32(0.999)
    for i in range(len(parameters)):
        slope = gradient[i]
        mean = first_decay * first[i] + (one - first_decay) * slope
        mean = mean if abs(mean) > SILENT else np.float32(0)
        square = second_decay * second[i] + (one - second_decay) * slope * slope
        parameters[i] -= rate * mean / (math.sqrt(square) * root + np.float32(1e-8))
        first[i], second[i] = mean, square


class RMSProp:
    """RMSProp with Keras' defaults (rho 0.9, epsilon 1e-7), since the thesis trained with Keras."""

    def __init__(self, parameters: Floats) -> None:
        self.moments: dict[str, NDArray[Any]] = {"second": np.zeros_like(parameters)}

    def step(self, parameters: Floats, gradient: Floats, learning_rate: float) -> None:
        _rmsprop(parameters, gradient, self.moments["second"], np.float32(learning_rate))


@compiled_freely
def _rmsprop(parameters: Floats, gradient: Floats, second: Floats, rate: np.float32) -> None:
    decay = np.float32(0.9)
    for i in range(len(parameters)):
        slope = gradient[i]
        square = decay * second[i] + (np.float32(1) - decay) * slope * slope
        square = square if square > SILENT else np.float32(0)
        parameters[i] -= rate * slope / (math.sqrt(square) + np.float32(1e-7))
        second[i] = square


def optimizer_of(name: Literal["adam", "rmsprop"], parameters: Floats) -> Optimizer:
    return Adam(parameters) if name == "adam" else RMSProp(parameters)
