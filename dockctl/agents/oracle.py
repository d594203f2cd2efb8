"""Double DQN by torch's autograd, short and slow: what `dockctl.agents.dqn` must equal."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from dockctl.agents.replay import Transitions

QFunction = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Batch:
    """`Transitions` as tensors on the learner's device."""

    observation: Tensor
    action: Tensor
    reward: Tensor
    discount: Tensor
    next_observation: Tensor

    @classmethod
    def of(cls, transitions: Transitions, device: torch.device) -> Batch:
        return cls(**{name: torch.from_numpy(array).to(device) for name, array in vars(transitions).items()})


@torch.no_grad()
def td_target(batch: Batch, online: QFunction, target: QFunction, largest: float = math.inf) -> Tensor:
    """Double DQN target, at most `largest`: the online network chooses the next action, the target network
    values it. (m,)"""
    best_action = online(batch.next_observation).argmax(dim=1, keepdim=True)
    next_value = target(batch.next_observation).gather(1, best_action).squeeze(1)
    return (batch.reward + batch.discount * next_value).clamp(max=largest)


def td_loss(q: Tensor, target: Tensor, huber_delta: float | None) -> Tensor:
    """Mean Huber loss, or mean squared error where `huber_delta` is None."""
    if huber_delta is None:
        return functional.mse_loss(q, target)
    return functional.huber_loss(q, target, delta=huber_delta)


def loss(
    batch: Batch,
    online: QFunction,
    target: QFunction,
    huber_delta: float | None,
    largest: float = math.inf,
) -> Tensor:
    """Loss of a batch, ready for `backward`."""
    q = online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
    return td_loss(q, td_target(batch, online, target, largest), huber_delta)
