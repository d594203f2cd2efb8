"""Adam and RMSProp on one vector: what `torch.optim` computes, without its work around the step."""

from __future__ import annotations

from typing import Literal, Protocol

import torch
from torch import Tensor


class Optimizer(Protocol):
    """Moves a vector of parameters along its gradient; `moments` is all that it remembers."""

    moments: dict[str, Tensor]

    def step(self, parameters: Tensor, gradient: Tensor, learning_rate: float) -> None: ...


class Adam:
    """Adam (Kingma and Ba 2015) with the paper's decay rates and epsilon, in one kernel."""

    def __init__(self, parameters: Tensor) -> None:
        first, second = torch.zeros_like(parameters), torch.zeros_like(parameters)
        self.moments = {"first": first, "second": second, "steps": parameters.new_zeros(())}

    def step(self, parameters: Tensor, gradient: Tensor, learning_rate: float) -> None:
        first, second, steps = self.moments.values()
        steps += 1
        torch._fused_adam_(
            [parameters],
            [gradient],
            [first],
            [second],
            [],
            [steps],
            lr=learning_rate,
            beta1=0.9,
            beta2=0.999,
            weight_decay=0.0,
            eps=1e-8,
            amsgrad=False,
            maximize=False,
        )


class RMSProp:
    """RMSProp with Keras' defaults (rho 0.9, epsilon 1e-7), since the thesis trained with Keras."""

    def __init__(self, parameters: Tensor) -> None:
        self.moments = {"second": torch.zeros_like(parameters)}
        self._root = torch.empty_like(parameters)

    def step(self, parameters: Tensor, gradient: Tensor, learning_rate: float) -> None:
        second = self.moments["second"]
        second.mul_(0.9).addcmul_(gradient, gradient, value=0.1)
        # Moments of silent units fade to denormal numbers, of which roots take ten times as long; this is far
        # below what epsilon lets through.
        root = torch.add(second, 1e-30, out=self._root).sqrt_()
        parameters.addcdiv_(gradient, root.add_(1e-7), value=-learning_rate)


def optimizer_of(name: Literal["adam", "rmsprop"], parameters: Tensor) -> Optimizer:
    return Adam(parameters) if name == "adam" else RMSProp(parameters)
