"""Double DQN: targets, loss and one gradient step (thesis eqs. 2.52-2.56, section 3.2.5), compiled."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.dqn import passes
from dockctl.agents.dqn.learner import UpdateMetrics
from dockctl.agents.dqn.network import DuelingQNetwork, Floats, Layer, Layers
from dockctl.agents.dqn.optimizers import optimizer_of
from dockctl.agents.dqn.passes import compiled_freely
from dockctl.agents.dqn.replay import Transitions
from dockctl.scenarios.training import Training


class Workspace(NamedTuple):
    """Room for an update with a batch of m transitions.

    Attributes:
        observations: (2 m, observation_size), the next observations above the observations, so that the
            online network sees both in one pass.
        online, target: outputs of the hidden layers, of `observations` and of the next observations alone.
        seen: the rows of `online` that belong to the observations.
        slopes: derivatives of the loss by `seen`, before they are rectified.
        output, gradient: the online network's folded output layer, and the derivatives by it.
    """

    observations: Floats
    online: tuple[Floats, ...]
    seen: tuple[Floats, ...]
    target: tuple[Floats, ...]
    slopes: tuple[Floats, ...]
    output: Layer
    gradient: Layer

    @classmethod
    def of(cls, layers: Layers, rows: int) -> Workspace:
        online = passes.room_for(layers, 2 * rows)
        return cls(
            np.zeros((2 * rows, layers.hidden[0].weight.shape[1]), np.float32),
            online,
            tuple(outputs[rows:] for outputs in online),
            passes.room_for(layers, rows),
            passes.room_for(layers, rows),
            passes.room_for_output(layers),
            passes.room_for_output(layers),
        )


class Loss(NamedTuple):
    """Huber's loss times `weight`: with a weight of 2 and no bound for the slope, the squared error.

    Attributes:
        delta: where the loss turns from a parabola into a line, the greatest slope.
        largest: no target is above it.
    """

    weight: float
    delta: float
    largest: float

    @classmethod
    def of(cls, training: Training) -> Loss:
        weight, delta = (2.0, math.inf) if training.huber_delta is None else (1.0, training.huber_delta)
        return cls(weight, delta, training.largest_target)


class DoubleDQN:
    """A `Learner` for the processor: an online and a target network, and the optimizer of the online one.

    It computes what `dockctl.agents.dqn.update` does, as matrix products into buffers that are allocated
    once, with the output layer only where it is used. The same batches give the same bits.

    Args:
        network: the online network; it is trained in place.
        training: loss, clipping, optimizer and target copies.

    Attributes:
        target: parameters of the target network, laid out as ``network.flat``.
        gradient: that of the last update, as the optimizer took it, laid out likewise.
    """

    def __init__(self, network: DuelingQNetwork, training: Training) -> None:
        passes.hold_to_one_thread()
        self.online, self.training, self.updates = network, training, 0
        self._parameters: Floats = network.flat.numpy()
        self.gradient, self.target = np.zeros_like(self._parameters), self._parameters.copy()
        self.optimizer = optimizer_of(training.optimizer, self._parameters)
        self._layers, self._gradient_layers, self._target_layers = (
            network.layers(vector) for vector in (self._parameters, self.gradient, self.target)
        )
        self._target_output = passes.room_for_output(self._layers)
        self._work = Workspace.of(self._layers, training.batch_size)
        self._loss = Loss.of(training)
        self.copy_to_target()

    def copy_to_target(self) -> None:
        self.target[:] = self._parameters
        passes.fold(self._target_layers, self._target_output)

    def state(self) -> dict[str, NDArray[Any]]:
        """Target network and optimizer's moments; see `Learner`."""
        moments = self.optimizer.moments
        return {
            "target.flat": self.target,
            **{f"optimizer.{name}": value for name, value in moments.items()},
        }

    def load(self, state: Mapping[str, NDArray[Any]], updates: int) -> None:
        """Take over what `state` returned; see `Learner`."""
        self.target[:] = state["target.flat"]
        passes.fold(self._target_layers, self._target_output)
        for name, moment in self.optimizer.moments.items():
            moment[...] = state[f"optimizer.{name}"]
        self.updates = updates

    def update(self, transitions: Transitions, learning_rate: float) -> UpdateMetrics:
        """One gradient step on a batch, and a copy to the target network when one is due."""
        rows = len(transitions.action)
        if len(self._work.observations) != 2 * rows:
            self._work = Workspace.of(self._layers, rows)
        self._work.observations[:rows] = transitions.next_observation
        self._work.observations[rows:] = transitions.observation
        loss, td_error, q_mean = _differentiate(
            self._layers, self._gradient_layers, self._target_layers, self._target_output,
            np.ascontiguousarray(transitions.action), np.ascontiguousarray(transitions.reward),
            np.ascontiguousarray(transitions.discount), self._loss, self._work,
        )  # fmt: skip
        clip = self.training.gradient_clip
        norm = _clip(self.gradient, math.inf if clip is None else clip)
        self.optimizer.step(self._parameters, self.gradient, learning_rate)
        self.updates += 1
        if self.updates % self.training.target_update_interval == 0:
            self.copy_to_target()
        return UpdateMetrics(loss, td_error, q_mean, norm)


@compiled_freely
def _differentiate(
    network: Layers,
    gradient: Layers,
    target: Layers,
    target_output: Layer,
    action: NDArray[np.int64],
    reward: Floats,
    discount: Floats,
    loss: Loss,
    work: Workspace,
) -> tuple[float, float, float]:
    """Write the gradient of the loss of `work.observations`; return loss, mean |TD error| and mean Q."""
    rows = len(action)
    next_observation, observation = work.observations[:rows], work.observations[rows:]
    hidden = passes.hidden_outputs(network, work.observations, work.online)
    target_hidden = passes.hidden_outputs(target, next_observation, work.target)
    # The online network chooses the next action, the target network values it (eq. 2.52).
    next_action = passes.greedy_from(network, hidden[:rows])
    passes.fold(network, work.output)
    work.gradient.weight.fill(0)
    work.gradient.bias.fill(0)
    seen, slopes = work.seen[-1], work.slopes[-1]
    share, total_loss, total_error, total_q = np.float32(loss.weight / rows), 0.0, 0.0, 0.0
    for row in range(rows):
        next_q = _value(target_output, next_action[row], target_hidden, row)
        q = _value(work.output, action[row], seen, row)
        td_error = q - min(reward[row] + discount[row] * next_q, np.float32(loss.largest))
        bounded = max(min(td_error, np.float32(loss.delta)), np.float32(-loss.delta))
        _back_through_value(work.output, work.gradient, action[row], seen, slopes, row, share * bounded)
        total_loss += loss.weight * float(bounded * (td_error - np.float32(0.5) * bounded))
        total_error += abs(float(td_error))
        total_q += float(q)
    passes.unfold(work.gradient, gradient)
    passes.backward(network, gradient, observation, work.seen, work.slopes)
    return total_loss / rows, total_error / rows, total_q / rows


@compiled_freely
def _value(output: Layer, action: int, hidden: Floats, row: int) -> np.float32:
    """Return Q of one action, from a row of outputs of the last hidden layer."""
    weight = output.weight
    value: np.float32 = output.bias[action]
    for column in range(hidden.shape[1]):
        value += weight[action, column] * hidden[row, column]
    return value


@compiled_freely
def _back_through_value(
    output: Layer, gradient: Layer, action: int, hidden: Floats, slopes: Floats, row: int, slope: np.float32
) -> None:
    """Carry the loss' slope by the Q that `_value` gave to the row of the output layer and to `hidden`."""
    weight, to_weight = output.weight, gradient.weight
    gradient.bias[action] += slope
    for column in range(hidden.shape[1]):
        to_weight[action, column] += slope * hidden[row, column]
        slopes[row, column] = slope * weight[action, column]


@compiled_freely
def _clip(gradient: Floats, largest: float) -> float:
    """Scale the gradient down to an L2 norm of at most `largest`; return the norm that it had."""
    squares = np.float32(0)
    for i in range(len(gradient)):
        squares += gradient[i] * gradient[i]
    norm = math.sqrt(squares)
    if norm > largest:
        scale = np.float32(largest / norm)
        for i in range(len(gradient)):
            gradient[i] *= scale
    return norm
