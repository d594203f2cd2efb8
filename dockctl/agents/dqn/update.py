"""One gradient step of double DQN (thesis eqs. 2.52-2.55, section 3.2.5)."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_

from dockctl.agents.dqn.compiled import CompiledGradient
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Batch, Transitions
from dockctl.agents.interface import Metrics
from dockctl.scenarios.training import Training

QFunction = Callable[[Tensor], Tensor]


@torch.no_grad()
def td_target(
    batch: Transitions[Tensor], online: QFunction, target: QFunction, largest: float = math.inf
) -> Tensor:
    """Return the TD target of double DQN, at most `largest`, (m,)."""
    next_action = online(batch.next_observation).argmax(dim=1, keepdim=True)
    next_value = target(batch.next_observation).gather(1, next_action).squeeze(1)
    return (batch.reward + batch.discount * next_value).clamp(max=largest)  # eq. 2.52


def td_loss(q: Tensor, target: Tensor, huber_delta: float | None) -> Tensor:
    """Return the mean Huber loss, or the mean squared error where `huber_delta` is None."""
    if huber_delta is None:
        return functional.mse_loss(q, target)
    return functional.huber_loss(q, target, delta=huber_delta)


def to_tensors(transitions: Batch, device: torch.device) -> Transitions[Tensor]:
    """Copy a batch to the device."""
    tensors = {name: torch.from_numpy(array).to(device) for name, array in vars(transitions).items()}
    return Transitions(**tensors)


class AutogradGradient:
    """The gradient of the loss by autograd, on the device of the networks.

    Args:
        online, target: networks; gradients are written to those of the `online` parameters.
        huber_delta: where the loss becomes linear; None for the squared error.
        largest: upper bound of the targets.
    """

    def __init__(
        self, online: nn.Module, target: nn.Module, huber_delta: float | None = 1.0, largest: float = math.inf
    ) -> None:
        self.online, self.target, self.huber_delta, self.largest = online, target, huber_delta, largest
        self.device = next(online.parameters()).device

    def __call__(self, transitions: Batch) -> tuple[float, float, float]:
        """Write the gradient of the loss of a batch; return loss, mean |TD error| and mean Q."""
        batch = to_tensors(transitions, self.device)
        target = td_target(batch, self.online, self.target, self.largest)
        q = self.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
        loss = td_loss(q, target, self.huber_delta)
        self.online.zero_grad()
        torch.autograd.backward(loss)
        q = q.detach()
        loss, td_error, q_mean = torch.stack((loss.detach(), (q - target).abs().mean(), q.mean())).tolist()
        return loss, td_error, q_mean


class DoubleDQN:
    """An online network, its optimizer, and a target network.

    Args:
        online: trained in place, on the device where it is.
        training: loss, clipping, optimizer and target copies.
    """

    def __init__(self, online: DuelingQNetwork, training: Training) -> None:
        self.online, self.target, self.training, self.updates = online, copy.deepcopy(online), training, 0
        on_processor = next(online.parameters()).device.type == "cpu"
        gradient = CompiledGradient if on_processor else AutogradGradient
        self.gradient = gradient(online, self.target, training.huber_delta, training.largest_target)
        self.optimizer: torch.optim.Optimizer
        if training.optimizer == "adam":
            self.optimizer = torch.optim.Adam(online.parameters(), fused=True)
        else:  # Keras' defaults, because the thesis used Keras
            self.optimizer = torch.optim.RMSprop(online.parameters(), alpha=0.9, eps=1e-7, foreach=True)

    def update(self, transitions: Batch, learning_rate: float) -> Metrics:
        """Make one gradient step on a batch, and copy to the target network when a copy is due."""
        loss, td_error, q_mean = self.gradient(transitions)
        clip = math.inf if self.training.gradient_clip is None else self.training.gradient_clip
        norm = float(clip_grad_norm_(self.online.parameters(), clip))
        self.optimizer.param_groups[0]["lr"] = learning_rate
        self.optimizer.step()

        self.updates += 1
        if self.updates % self.training.target_update_interval == 0:
            self.target.load_state_dict(self.online.state_dict())
        return {"loss": loss, "td_error": td_error, "q_mean": q_mean, "gradient_norm": norm}
