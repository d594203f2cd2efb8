"""Double DQN: targets, loss and one gradient step (thesis eqs. 2.52-2.56, section 3.2.5)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from dockctl.agents.network import DuelingQNetwork
from dockctl.agents.replay import Transitions
from dockctl.scenarios.training import Training

QFunction = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class UpdateMetrics:
    """Loss, mean |TD error|, mean Q of the actions taken, and gradient norm before clipping."""

    loss: float
    td_error: float
    q_mean: float
    gradient_norm: float


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
def td_target(batch: Batch, online: QFunction, target: QFunction) -> Tensor:
    """Double DQN target: the online network chooses the next action, the target network values it. (m,)"""
    best_action = online(batch.next_observation).argmax(dim=1, keepdim=True)
    next_value = target(batch.next_observation).gather(1, best_action).squeeze(1)
    return batch.reward + batch.discount * next_value


def td_loss(q: Tensor, target: Tensor, huber_delta: float | None) -> Tensor:
    """Mean Huber loss, or mean squared error where `huber_delta` is None."""
    if huber_delta is None:
        return functional.mse_loss(q, target)
    return functional.huber_loss(q, target, delta=huber_delta)


class DoubleDQN:
    """An online and a target network, and the optimizer that moves the online one.

    Args:
        network: the online network; it is trained in place.
        training: loss, clipping, optimizer and target copies.
    """

    def __init__(self, network: DuelingQNetwork, training: Training) -> None:
        self.online = network
        self.target = DuelingQNetwork(network.observation_size, network.actions, network.hidden_sizes)
        self.target.to_device(network.flat.device)
        self.copy_to_target()
        self.training = training
        self.updates = 0
        self.optimizer = _optimizer(network.flat, training)

    def copy_to_target(self) -> None:
        self.target.flat.copy_(self.online.flat)

    def state(self) -> dict[str, NDArray[Any]]:
        """Target network and optimizer's moments, for a checkpoint (which holds the online network apart)."""
        moments = self.optimizer.state[self.online.flat]
        return {
            "target": self.target.flat.cpu().numpy(),
            **{f"optimizer.{name}": value.cpu().numpy() for name, value in moments.items()},
        }

    def load(self, state: Mapping[str, NDArray[Any]], updates: int) -> None:
        """Take over what `state` returned after so many updates.

        Raises:
            KeyError, RuntimeError: the state is of another network.
        """
        device = self.online.flat.device
        self.target.flat.copy_(torch.from_numpy(state["target"]))
        prefix = "optimizer."
        self.optimizer.state[self.online.flat] = {
            name.removeprefix(prefix): torch.from_numpy(value).to(device)
            for name, value in state.items()
            if name.startswith(prefix)
        }
        self.updates = updates

    def update(self, transitions: Transitions, learning_rate: float) -> UpdateMetrics:
        """One gradient step on a batch, and a copy to the target network when one is due."""
        batch = Batch.of(transitions, self.online.flat.device)
        target = td_target(batch, self.online, self.target)
        q = self.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
        loss = td_loss(q, target, self.training.huber_delta)
        gradient = self.online.flat.grad
        assert gradient is not None  # made with the network
        gradient.zero_()
        loss.backward()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        norm = float(gradient.norm())
        if self.training.gradient_clip is not None and norm > self.training.gradient_clip:
            gradient.mul_(self.training.gradient_clip / norm)
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate
        self.optimizer.step()
        self.updates += 1
        if self.updates % self.training.target_update_interval == 0:
            self.copy_to_target()
        td_error, q_mean = (q.detach() - target).abs().mean(), q.detach().mean()
        return UpdateMetrics(float(loss.detach()), float(td_error), float(q_mean), norm)


def _optimizer(flat: Tensor, training: Training) -> torch.optim.Optimizer:
    """Adam, or RMSProp with Keras' defaults (rho 0.9, epsilon 1e-7), since the thesis trained with Keras."""
    if training.optimizer == "adam":
        return torch.optim.Adam([flat], lr=training.learning_rate, fused=True)
    return torch.optim.RMSprop([flat], lr=training.learning_rate, alpha=0.9, eps=1e-7)
