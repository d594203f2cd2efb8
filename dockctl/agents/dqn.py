"""Double DQN: targets, loss and one gradient step (thesis eqs. 2.52-2.56, section 3.2.5)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import torch
from numpy.typing import NDArray
from torch import Tensor

from dockctl.agents import passes
from dockctl.agents.network import DuelingQNetwork
from dockctl.agents.optimizers import optimizer_of
from dockctl.agents.replay import Transitions
from dockctl.scenarios.training import Training


class UpdateMetrics(NamedTuple):
    """Loss, mean |TD error|, mean Q of the actions taken, and gradient norm before clipping."""

    loss: float
    td_error: float
    q_mean: float
    gradient_norm: float


class Workspace:
    """Buffers of an update with a batch of m transitions.

    Attributes:
        observations: (2 m, observation_size), the next observations above the observations, so that the
            online network sees both in one pass.
        online, target: outputs of the hidden layers, of `observations` and of the next observations alone.
        seen: the rows of `online` that belong to the observations.
        slopes: derivatives of the loss by `seen`.
    """

    def __init__(self, network: DuelingQNetwork, rows: int) -> None:
        layers = network.layers(network.flat)
        self.rows = rows
        self.observations = network.flat.new_empty(2 * rows, network.observation_size)
        self.next_observation, self.observation = self.observations[:rows], self.observations[rows:]
        self.online = passes.buffers_for(layers, 2 * rows)
        self.seen = [outputs[rows:] for outputs in self.online]
        self.target, self.slopes = passes.buffers_for(layers, rows), passes.buffers_for(layers, rows)


class DoubleDQN:
    """An online and a target network, and the optimizer that moves the online one.

    It computes what `dockctl.agents.oracle` does by autograd, as products of matrices into buffers that are
    made once, and with the output layer only where it is used.

    On the CPU the same batches give the same bits; a GPU adds up the output layer's gradient in any order.

    Args:
        network: the online network; it is trained in place.
        training: loss, clipping, optimizer and target copies.

    Attributes:
        target: parameters of the target network, laid out as ``network.flat``.
        gradient: that of the last update, as the optimizer took it; it is ``network.flat.grad``.
    """

    def __init__(self, network: DuelingQNetwork, training: Training) -> None:
        self.online, self.training, self.updates = network, training, 0
        assert network.flat.grad is not None  # made with the network
        self.gradient, self.target = network.flat.grad, network.flat.clone()
        self.optimizer = optimizer_of(training.optimizer, network.flat)
        self._layers, self._gradient_layers, self._target_layers = (
            network.layers(vector) for vector in (network.flat, self.gradient, self.target)
        )
        self._output, self._output_gradient, self._target_output = (
            passes.empty_output(self._layers) for _ in range(3)
        )
        self._work = Workspace(network, training.batch_size)
        largest = training.largest_return
        self._largest = math.inf if largest is None else largest * training.reward_scale
        self.copy_to_target()

    def copy_to_target(self) -> None:
        self.target.copy_(self.online.flat)
        passes.fold(self._target_layers, self._target_output)

    def state(self) -> dict[str, NDArray[Any]]:
        """Target network and optimizer's moments, for a checkpoint (which holds the online network apart)."""
        return {
            "target.flat": self.target.cpu().numpy(),
            **{f"optimizer.{name}": value.cpu().numpy() for name, value in self.optimizer.moments.items()},
        }

    def load(self, state: Mapping[str, NDArray[Any]], updates: int) -> None:
        """Take over what `state` returned after so many updates.

        Raises:
            KeyError, RuntimeError: the state is of another network.
        """
        self.target.copy_(torch.from_numpy(state["target.flat"]))
        passes.fold(self._target_layers, self._target_output)
        for name, moment in self.optimizer.moments.items():
            moment.copy_(torch.from_numpy(state[f"optimizer.{name}"]))
        self.updates = updates

    @torch.inference_mode()
    def update(self, transitions: Transitions, learning_rate: float) -> UpdateMetrics:
        """One gradient step on a batch, and a copy to the target network when one is due."""
        loss, td_error, q_mean = self._differentiate(transitions)
        norm = math.sqrt(torch.dot(self.gradient, self.gradient))
        clip = self.training.gradient_clip
        if clip is not None and norm > clip:
            self.gradient.mul_(clip / norm)
        self.optimizer.step(self.online.flat, self.gradient, learning_rate)
        self.updates += 1
        if self.updates % self.training.target_update_interval == 0:
            self.copy_to_target()
        return UpdateMetrics(loss, td_error, q_mean, norm)

    def _differentiate(self, transitions: Transitions) -> list[float]:
        """Put the gradient of the loss into `gradient`; return loss, mean |TD error| and mean Q."""
        work, device = self._workspace(len(transitions.action)), self.gradient.device
        work.next_observation.copy_(torch.from_numpy(transitions.next_observation))
        work.observation.copy_(torch.from_numpy(transitions.observation))
        action, reward, discount = (
            torch.from_numpy(array).to(device)
            for array in (transitions.action, transitions.reward, transitions.discount)
        )
        # The targets: the online network chooses the next action, the target network values it (eq. 2.52).
        hidden = passes.hidden_outputs(self._layers, work.observations, work.online)
        best_action = passes.greedy_action(self._layers, hidden[: work.rows])
        next_hidden = passes.hidden_outputs(self._target_layers, work.next_observation, work.target)
        next_value, _ = passes.value_of(self._target_output, next_hidden, best_action)
        # The values of the actions taken, and the loss.
        passes.fold(self._layers, self._output)
        q, chosen = passes.value_of(self._output, work.seen[-1], action)
        td_error = q - torch.addcmul(reward, discount, next_value).clamp_(max=self._largest)
        loss, slope = _loss(td_error, self.training.huber_delta)
        slope /= work.rows
        # Back through the output layer, of which each transition used one row, and through the hidden layers.
        torch.mul(chosen, slope.unsqueeze(1), out=work.slopes[-1])
        self._output_gradient.weight.zero_().index_add_(0, action, work.seen[-1] * slope.unsqueeze(1))
        self._output_gradient.bias.zero_().index_add_(0, action, slope)
        passes.unfold(self._output_gradient, self._gradient_layers)
        passes.backward(self._layers, self._gradient_layers, work.observation, work.seen, work.slopes)
        return torch.stack((loss, td_error.abs(), q)).mean(1).tolist()

    def _workspace(self, rows: int) -> Workspace:
        if self._work.rows != rows:
            self._work = Workspace(self.online, rows)
        return self._work


def _loss(td_error: Tensor, huber_delta: float | None) -> tuple[Tensor, Tensor]:
    """Loss of each transition, Huber's or squared without a delta, and its derivative by Q; both (m,)."""
    if huber_delta is None:
        return td_error.square(), 2 * td_error
    bounded = td_error.clamp(-huber_delta, huber_delta)
    return bounded * torch.sub(td_error, bounded, alpha=0.5), bounded
