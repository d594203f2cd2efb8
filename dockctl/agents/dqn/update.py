"""Double DQN by torch's autograd on any device; `dockctl.agents.dqn.compiled` is tested against it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from dockctl.agents.dqn.learner import UpdateMetrics
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Transitions
from dockctl.scenarios.training import Training

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


def q_of(batch: Batch, online: QFunction) -> Tensor:
    """Values of the actions taken. (m,)"""
    return online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)


def td_loss(q: Tensor, target: Tensor, huber_delta: float | None) -> Tensor:
    """Mean Huber loss, or mean squared error where `huber_delta` is None."""
    if huber_delta is None:
        return functional.mse_loss(q, target)
    return functional.huber_loss(q, target, delta=huber_delta)


class AutogradDQN:
    """A `Learner` whose networks live on `device`; after every update the parameters come back to `network`.

    Args:
        network: the online network in main memory.
        training: loss, clipping, optimizer and target copies.
        device: where it computes.
    """

    def __init__(self, network: DuelingQNetwork, training: Training, device: torch.device) -> None:
        self.online, self.training, self.updates, self.device = network, training, 0, device
        self._learning, self._target = network.copy_on(device), network.copy_on(device)
        flat = self._learning.flat
        self._optimizer: torch.optim.Optimizer
        # Names of the moments in a checkpoint, and those that torch has for them.
        self._names = {"second": "square_avg"}
        if training.optimizer == "adam":
            self._optimizer = torch.optim.Adam([flat])
            self._names = {"first": "exp_avg", "second": "exp_avg_sq", "steps": "step"}
        else:  # with Keras' defaults, since the thesis trained with Keras
            self._optimizer = torch.optim.RMSprop([flat], alpha=0.9, eps=1e-7)
        moments = {name: torch.zeros_like(flat) for name in self._names.values()}
        self._moments = self._optimizer.state[flat] = {**moments, "step": torch.zeros(())}

    def state(self) -> dict[str, NDArray[Any]]:
        """Target network and optimizer's moments; see `Learner`."""
        moments = {f"optimizer.{ours}": self._moments[theirs] for ours, theirs in self._names.items()}
        return {
            name: value.cpu().numpy() for name, value in {"target.flat": self._target.flat, **moments}.items()
        }

    def load(self, state: Mapping[str, NDArray[Any]], updates: int) -> None:
        """Take over what `state` returned; see `Learner`."""
        self._learning.flat.copy_(self.online.flat)
        self._target.flat.copy_(torch.from_numpy(state["target.flat"]))
        for ours, theirs in self._names.items():
            self._moments[theirs].copy_(torch.from_numpy(state[f"optimizer.{ours}"]))
        self.updates = updates

    def update(self, transitions: Transitions, learning_rate: float) -> UpdateMetrics:
        """One gradient step on a batch, and a copy to the target network when one is due."""
        batch, gradient = Batch.of(transitions, self.device), self._learning.flat.grad
        assert gradient is not None  # made with the network
        gradient.zero_()
        q = q_of(batch, self._learning)
        target = td_target(batch, self._learning, self._target, self.training.largest_target)
        loss = td_loss(q, target, self.training.huber_delta)
        torch.autograd.backward(loss)
        norm = gradient.norm()
        clip = self.training.gradient_clip
        if clip is not None:
            gradient.mul_((clip / norm).clamp(max=1))
        self._optimizer.param_groups[0]["lr"] = learning_rate
        self._optimizer.step()
        self.updates += 1
        if self.updates % self.training.target_update_interval == 0:
            self._target.flat.copy_(self._learning.flat)
        self.online.flat.copy_(self._learning.flat)
        told = torch.stack((loss.detach(), (q.detach() - target).abs().mean(), q.detach().mean(), norm))
        return UpdateMetrics(*told.tolist())
