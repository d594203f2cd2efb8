"""One gradient step of double DQN (thesis eqs. 2.52-2.55, section 3.2.5)."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils import clip_grad_norm_

from dockctl.agents.dqn.compiled import DECAYS, CompiledSteps
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Batch, Transitions
from dockctl.agents.interface import Metrics, Tensors
from dockctl.agents.tensors import load_optimizer, load_parameters, numpy_tensors, optimizer_tensors
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
    return Transitions(*(torch.from_numpy(array).to(device) for array in transitions))


class AutogradSteps:
    """Gradient steps with torch's autograd and optimizer, on the device of the networks.

    Args:
        online: trained in place.
        target: gives the values of the next observations.
        acting: networks that act.
        training: loss, clipping and optimizer.
    """

    def __init__(
        self, online: nn.Module, target: nn.Module, acting: Sequence[nn.Module], training: Training
    ) -> None:
        self.online, self.target, self.acting, self.training = online, target, acting, training
        self.device = next(online.parameters()).device
        mean, square, epsilon = DECAYS[training.optimizer]
        self.optimizer: torch.optim.Optimizer
        if training.optimizer == "adam":
            self.optimizer = torch.optim.Adam(
                online.parameters(), betas=(mean, square), eps=epsilon, fused=True
            )
        else:
            self.optimizer = torch.optim.RMSprop(online.parameters(), alpha=square, eps=epsilon, foreach=True)

    def __call__(self, transitions: Batch, learning_rate: float, steps: int) -> list[Metrics]:
        """Take steps with equal parts of the transitions; return the metrics of each.

        They are the loss, the mean |TD error|, the mean Q, and the gradient norm before clipping.
        """
        tensors = to_tensors(transitions, self.device)
        parts = zip(*(tensor.tensor_split(steps) for tensor in tensors), strict=True)
        return [self._step(Transitions(*part), learning_rate) for part in parts]

    def _step(self, batch: Transitions[Tensor], learning_rate: float) -> Metrics:
        target = td_target(batch, self.online, self.target, self.training.largest_target)
        q = self.online(batch.observation).gather(1, batch.action.unsqueeze(1)).squeeze(1)
        loss = td_loss(q, target, self.training.huber_delta)
        self.optimizer.zero_grad()
        torch.autograd.backward(loss)
        norm = clip_grad_norm_(self.online.parameters(), self.training.largest_gradient)
        self.optimizer.param_groups[0]["lr"] = learning_rate
        self.optimizer.step()
        q = q.detach()
        metrics = torch.stack((loss.detach(), (q - target).abs().mean(), q.mean(), norm)).tolist()
        return dict(zip(("loss", "td_error", "q_mean", "gradient_norm"), metrics, strict=True))

    @torch.inference_mode()
    def greedy(self, observation: NDArray[Any], slot: int) -> NDArray[np.int64]:
        """Return the greedy actions of an acting network, (n, observation_size) to (n,)."""
        values = self.acting[slot](torch.as_tensor(observation, dtype=torch.float32, device=self.device))
        return np.asarray(values.argmax(dim=1).cpu())

    def moments(self) -> dict[str, NDArray[Any]]:
        """Return the moments of the optimizer; see `optimizer_tensors`."""
        return optimizer_tensors(self.optimizer)

    def load_moments(self, tensors: Tensors) -> None:
        """Continue with the moments that `moments` returned; see `load_optimizer`."""
        load_optimizer(self.optimizer, tensors)


class DoubleDQN:
    """An online network, its optimizer, a target network, and the network that is evaluated.

    The evaluated network is the exponential moving average of the copies to the target network, because the
    greedy policy of the online network, and with it the success rate, fluctuates from update to update.
    Without averaging it is the online network itself.

    Attributes:
        acting: two copies of the online network, from different times, which act while it learns.
        first: parameters with which each part of the training begins.
        part, begun: number of the part, and of updates before it.
        snapshots: parameters of the evaluated network at earlier times, newest first, for an ensemble.
        finished: parameters of the evaluated networks of earlier parts, newest first.

    Args:
        online: trained in place, on the device where it is.
        training: loss, clipping, optimizer, target copies and their average.
    """

    def __init__(self, online: DuelingQNetwork, training: Training) -> None:
        self.online, self.target, self.training, self.updates = online, copy.deepcopy(online), training, 0
        self.evaluated = online if training.averaged_copies is None else copy.deepcopy(online)
        self.first: Tensors = numpy_tensors(online.state_dict())
        self.part, self.begun = 0, 0
        self.snapshots: list[Tensors] = []
        self.finished: list[Tensors] = []
        self.acting = copy.deepcopy(online), copy.deepcopy(online)
        on_cpu = next(online.parameters()).device.type == "cpu"
        steps = CompiledSteps if on_cpu else AutogradSteps
        self.steps = steps(online, self.target, self.acting, training)

    def greedy(self, observation: NDArray[Any], slot: int) -> NDArray[np.int64]:
        """Return the greedy actions of a copy in `acting`, (n, observation_size) to (n,)."""
        return self.steps.greedy(observation, slot)

    @torch.no_grad()
    def publish(self, slot: int) -> None:
        """Copy the parameters of the online network to a copy in `acting`."""
        for copied, parameter in zip(self.acting[slot].parameters(), self.online.parameters(), strict=True):
            copied.copy_(parameter)

    def publish_all(self) -> None:
        """Copy the parameters of the online network to both copies in `acting`."""
        for slot in range(len(self.acting)):
            self.publish(slot)

    def update(self, transitions: Batch, learning_rate: float, steps: int = 1) -> list[Metrics]:
        """Take gradient steps, and copy to the target network whenever a copy is due.

        Args:
            transitions: concatenated batches of equal size, one for each step.
            learning_rate: of all steps.
            steps: number of gradient steps.

        Returns:
            The metrics of each step.
        """
        metrics, size = list[Metrics](), len(transitions.action) // steps
        interval = self.training.target_update_interval
        while (first := len(metrics)) < steps:
            last = min(steps, first + interval - self.updates % interval)
            part = Transitions(*(array[first * size : last * size] for array in transitions))
            metrics += self.steps(part, learning_rate, last - first)
            self.updates += last - first
            if self.updates % interval == 0:
                self._copy()
        return metrics

    @torch.no_grad()
    def _copy(self) -> None:
        """Copy the online network to the target network, and average the copies, the first ones equally."""
        self.target.load_state_dict(self.online.state_dict())
        interval = self.training.target_update_interval
        copies = self.updates // interval - self.begun // interval
        if self.training.averaged_copies is not None:
            weight = 1 / min(copies, self.training.averaged_copies)
            for average, copied in zip(self.evaluated.parameters(), self.target.parameters(), strict=True):
                average.lerp_(copied, weight)
        ensemble = self.training.ensemble
        if ensemble is not None and copies % self.training.copies_between_snapshots == 0:
            newest = numpy_tensors(self.evaluated.state_dict())
            self.snapshots = [newest, *self.snapshots][: ensemble.networks - 1]

    def start_from(self, parameters: Tensors) -> None:
        """Begin each part of the training with these parameters."""
        self.first = parameters
        self._reset()
        self.publish_all()

    def begin(self, part: int) -> None:
        """Begin a part of the training; the networks of the part before are kept.

        Acting copies change only with `publish`, because one of them may be acting.
        """
        newest = numpy_tensors(self.evaluated.state_dict())
        self.finished, self.snapshots = [newest, *self.snapshots, *self.finished], []
        self._reset()
        self.steps.load_moments({})
        self.part, self.begun = part, self.updates

    def _reset(self) -> None:
        for network in (self.online, self.target, self.evaluated):
            load_parameters(network, self.first)
