"""The gradient steps of double DQN, compiled for the CPU.

The fast path of `update.AutogradSteps`, which computes the same in torch. One call, which releases the GIL,
does the loss, gradient, clipping and optimizer of all due steps, so that learning does not delay the
simulation.

Equation 2.56 is linear in the outputs of the hidden layers of the two streams. With the mean over the actions
subtracted from the advantage's last layer, the value of one action is two dot products, and the values of the
other actions are computed only where the largest is needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg.cython_blas  # noqa: F401  # loads the BLAS that compiled code calls
import torch
from numpy.typing import NDArray

from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Batch, Transitions
from dockctl.agents.interface import Metrics, Tensors
from dockctl.compute import compiled, limit_blas_threads
from dockctl.geometry import Floats
from dockctl.scenarios.training import Training

Floats32 = NDArray[np.float32]

DECAYS = {"adam": (0.9, 0.999, 1e-8), "rmsprop": (0.0, 0.9, 1e-7)}
"""Decays of the two moments, and epsilon; for RMSprop the defaults of Keras, which the thesis used."""

# Sums may be reordered, so that one instruction adds several terms. No array is assigned to a slice: for each
# such assignment numba compiles an error message, which takes longer than the rest of the function.
_compiled = compiled(error_model="numpy", fastmath={"arcp", "contract", "nsz", "reassoc"})


class Layer(NamedTuple):
    """Weight (outputs, inputs) and bias (outputs,) of a linear layer, or the gradients w.r.t. them."""

    weight: Floats32
    bias: Floats32


class Layers(NamedTuple):
    """A dueling network as arrays that share the memory of its tensors.

    Attributes:
        shared: the layers that both streams share.
        value_hidden, value, advantage_hidden, advantage: the layers of the streams.
    """

    shared: tuple[Layer, ...]
    value_hidden: Layer
    value: Layer
    advantage_hidden: Layer
    advantage: Layer

    @classmethod
    def parameters(cls, network: DuelingQNetwork) -> Layers:
        return cls._of([parameter.detach() for parameter in network.parameters()])

    @classmethod
    def gradients(cls, network: DuelingQNetwork) -> Layers:
        return cls._of([parameter.grad for parameter in network.parameters() if parameter.grad is not None])

    @classmethod
    def _of(cls, tensors: list[torch.Tensor]) -> Layers:
        """Pair weights and biases, which are in the order in which the network defines its layers."""
        arrays = [tensor.numpy() for tensor in tensors]
        layers = [Layer(*pair) for pair in zip(arrays[::2], arrays[1::2], strict=True)]
        return cls(tuple(layers[:-4]), *layers[-4:])


class Outputs(NamedTuple):
    """Buffers for the outputs of the hidden layers, (rows, outputs) each, or for derivatives w.r.t. them."""

    shared: tuple[Floats32, ...]
    value: Floats32
    advantage: Floats32

    @classmethod
    def allocate(cls, layers: Layers, rows: int) -> Outputs:
        def array(layer: Layer) -> Floats32:
            return np.zeros((rows, len(layer.bias)), np.float32)

        return cls(
            tuple(map(array, layers.shared)), array(layers.value_hidden), array(layers.advantage_hidden)
        )


class Parameter(NamedTuple):
    """The values of one tensor, its gradient, and the optimizer's moments, (k,) each.

    Attributes:
        mean: first moment; the gradient itself for RMSprop.
        square: second moment.
    """

    value: Floats32
    gradient: Floats32
    mean: Floats32
    square: Floats32


class Loss(NamedTuple):
    """Loss and clipping: half the weight times the squared error, linear beyond `delta`.

    Attributes:
        weight: 1 for the Huber loss; 2 with an infinite delta for the squared error.
        largest_target, largest_gradient: bounds of a target and of the gradient's norm.
    """

    weight: np.float32
    delta: np.float32
    largest_target: np.float32
    largest_gradient: np.float32


class Work(NamedTuple):
    """Buffers of a gradient step: layer outputs for both observations, and derivatives."""

    outputs: Outputs
    next_outputs: Outputs
    derivatives: Outputs

    @classmethod
    def allocate(cls, layers: Layers, rows: int) -> Work:
        return cls(*(Outputs.allocate(layers, rows) for _ in cls._fields))


class CompiledSteps:
    """Gradient steps on the CPU; see `update.AutogradSteps` for the arguments."""

    def __init__(
        self,
        online: DuelingQNetwork,
        target: DuelingQNetwork,
        acting: Sequence[DuelingQNetwork],
        training: Training,
    ) -> None:
        limit_blas_threads()
        for parameter in online.parameters():
            parameter.grad = torch.zeros_like(parameter)
        self._online, self._target = Layers.parameters(online), Layers.parameters(target)
        self._acting = [Layers.parameters(network) for network in acting]
        self._gradient, self._training = Layers.gradients(online), training
        weight, delta = (2.0, math.inf) if training.huber_delta is None else (1.0, training.huber_delta)
        bounds = training.largest_target, training.largest_gradient
        self._loss = Loss(*map(np.float32, (weight, delta, *bounds)))
        self._count = np.zeros((), np.float32)
        self._moments: dict[str, Floats32] = {}
        self._parameters = tuple(self._parameter(*numbered) for numbered in enumerate(online.parameters()))
        self._rows = self._boats = 0

    def __call__(self, transitions: Batch, learning_rate: float, steps: int) -> list[Metrics]:
        """Take steps with equal parts of the transitions; return the metrics of each, see `AutogradSteps`."""
        if len(transitions.action) != steps * self._rows:
            self._rows = len(transitions.action) // steps
            self._work = Work.allocate(self._online, self._rows)
        rates = np.array([self._rates(learning_rate) for _ in range(steps)], np.float32)
        metrics = _steps(
            self._online, self._target, self._gradient, self._parameters, transitions, self._loss, rates,
            self._work,
        )  # fmt: skip
        return [
            dict(zip(("loss", "td_error", "q_mean", "gradient_norm"), row, strict=True))
            for row in metrics.tolist()
        ]

    def greedy(self, observation: Floats32, slot: int) -> NDArray[np.int64]:
        """Return the greedy actions of an acting network, (n, observation_size) to (n,)."""
        if len(observation) != self._boats:
            self._boats = len(observation)
            self._outputs = Outputs.allocate(self._online, self._boats)
        actions: NDArray[np.int64] = _act(
            self._acting[slot], np.ascontiguousarray(observation, np.float32), self._outputs
        )
        return actions

    def moments(self) -> dict[str, NDArray[Any]]:
        """Return the moments and the step count, named as by `tensors.optimizer_tensors`."""
        return {name: array.copy() for name, array in self._moments.items()}

    def load_moments(self, tensors: Tensors) -> None:
        """Continue with the moments that `moments` returned; torch has none before the first step.

        Raises:
            ValueError: they belong to a different network or optimizer.
        """
        tensors = tensors or {name: np.zeros_like(array) for name, array in self._moments.items()}
        given, expected = (
            {name: (array.dtype, array.shape) for name, array in each.items()}
            for each in (tensors, self._moments)
        )
        if given != expected:
            raise ValueError("the optimizer's moments do not match its parameters")
        for name, array in self._moments.items():
            array[...] = tensors[name]

    def _parameter(self, number: int, parameter: torch.nn.Parameter) -> Parameter:
        """Return the parameter as arrays that share its memory, and allocate its moments."""
        assert parameter.grad is not None
        value, gradient = parameter.detach().numpy(), parameter.grad.numpy()
        square = np.zeros_like(value)
        if self._training.optimizer == "adam":
            mean = np.zeros_like(value)
            moments = {"exp_avg": mean, "exp_avg_sq": square}
        else:
            mean, moments = gradient, {"square_avg": square}
        for name, array in {"step": self._count, **moments}.items():
            self._moments[f"{number}.{name}"] = array
        return Parameter(*(array.reshape(-1) for array in (value, gradient, mean, square)))

    def _rates(self, learning_rate: float) -> tuple[float, ...]:
        """Count a step, and return the optimizer's coefficients for it; see `_optimize`."""
        self._count += 1
        step, (mean, square, epsilon) = self._count.item(), DECAYS[self._training.optimizer]
        if self._training.optimizer == "adam":
            return learning_rate / (1 - mean**step), mean, square, 1 / math.sqrt(1 - square**step), epsilon
        return learning_rate, mean, square, 1.0, epsilon


@_compiled
def _steps(
    online: Layers,
    target: Layers,
    gradient: Layers,
    parameters: tuple[Parameter, ...],
    transitions: Batch,
    loss: Loss,
    rates: Floats32,
    work: Work,
) -> Floats:
    """Return loss, mean |TD error|, mean Q and gradient norm of each step, (steps, 4)."""
    metrics, rows = np.empty((len(rates), 4)), len(transitions.action) // len(rates)
    for step in range(len(rates)):
        part = slice(step * rows, (step + 1) * rows)
        batch = Transitions(
            transitions.observation[part],
            transitions.action[part],
            transitions.reward[part],
            transitions.discount[part],
            transitions.next_observation[part],
        )
        metrics[step, 0], metrics[step, 1], metrics[step, 2] = _gradient(
            online, target, gradient, batch, loss, work
        )
        squares = 0.0
        for parameter in parameters:
            squares += float(np.dot(parameter.gradient, parameter.gradient))
        norm = metrics[step, 3] = math.sqrt(squares)
        for parameter in parameters:
            if norm > loss.largest_gradient:
                scale = np.float32(loss.largest_gradient / norm)
                np.multiply(parameter.gradient, scale, parameter.gradient)
            _optimize(parameter, rates[step])
    return metrics


@_compiled
def _act(online: Layers, observation: Floats32, outputs: Outputs) -> NDArray[np.int64]:
    _forward(online, observation, outputs)
    return _greedy(online.advantage, outputs.advantage)


@_compiled
def _optimize(parameter: Parameter, rates: Floats32) -> None:
    """Take a step of Adam (Kingma and Ba 2015, algorithm 1), or of RMSprop, which keeps no mean.

    Args:
        parameter: changed in place.
        rates: learning rate, for Adam divided by the bias correction of the first moment; decay of the first
            and of the second moment; factor on the root of the second moment; epsilon.
    """
    one, (value, gradient, mean, square) = np.float32(1), parameter
    learning_rate, keep, keep_square, unbias, epsilon = rates
    for i in range(len(value)):
        mean[i] = keep * mean[i] + (one - keep) * gradient[i]
        square[i] = keep_square * square[i] + (one - keep_square) * gradient[i] * gradient[i]
        value[i] -= learning_rate * mean[i] / (math.sqrt(square[i]) * unbias + epsilon)


@_compiled
def _gradient(
    online: Layers, target: Layers, gradient: Layers, batch: Batch, loss: Loss, work: Work
) -> tuple[float, float, float]:
    """Write the gradient; return the loss, the mean |TD error| and the mean Q."""
    rows = len(batch.action)
    _forward(online, batch.next_observation, work.next_outputs)
    next_action = _greedy(online.advantage, work.next_outputs.advantage)
    _forward(target, batch.next_observation, work.next_outputs)
    next_q = _values(target, _centered(target.advantage), work.next_outputs, next_action)
    _forward(online, batch.observation, work.outputs)
    advantage = _centered(online.advantage)
    q = _values(online, advantage, work.outputs, batch.action)

    q_gradient = np.empty(rows, np.float32)
    total_loss, total_error = 0.0, 0.0
    for i in range(rows):
        error = q[i] - min(batch.reward[i] + batch.discount[i] * next_q[i], loss.largest_target)  # eq. 2.52
        bounded = max(min(error, loss.delta), -loss.delta)
        q_gradient[i] = loss.weight * bounded / np.float32(rows)
        total_loss += float(loss.weight * bounded * (error - np.float32(0.5) * bounded))
        total_error += abs(float(error))

    _backward_output(online, advantage, gradient, batch.action, q_gradient, work.outputs, work.derivatives)
    _backward_streams(online, gradient, batch.observation, work.outputs, work.derivatives)
    return total_loss / rows, total_error / rows, float(q.mean())


@_compiled
def _layer(layer: Layer, inputs: Floats32, outputs: Floats32) -> None:
    """Write max(0, x W^T + b) into `outputs`."""
    np.dot(inputs, layer.weight.T, outputs)
    for row in range(len(outputs)):
        for column in range(len(layer.bias)):
            outputs[row, column] = max(outputs[row, column] + layer.bias[column], np.float32(0))


@_compiled
def _forward(layers: Layers, observation: Floats32, outputs: Outputs) -> None:
    """Write the outputs of all hidden layers."""
    below = observation
    for depth in range(len(layers.shared)):
        _layer(layers.shared[depth], below, outputs.shared[depth])
        below = outputs.shared[depth]
    _layer(layers.value_hidden, below, outputs.value)
    _layer(layers.advantage_hidden, below, outputs.advantage)


@_compiled
def _greedy(layer: Layer, hidden: Floats32) -> NDArray[np.int64]:
    """Return the action with the largest advantage, which has the largest value, (rows,)."""
    advantage = np.dot(hidden, layer.weight.T)
    best = np.zeros(len(hidden), np.int64)
    for row in range(len(hidden)):
        largest = advantage[row, 0] + layer.bias[0]
        for action in range(1, len(layer.bias)):
            if advantage[row, action] + layer.bias[action] > largest:
                largest, best[row] = advantage[row, action] + layer.bias[action], action
    return best


@_compiled
def _centered(layer: Layer) -> Layer:
    """Return the layer minus the mean of its rows, A - mean A; the operation is self-adjoint."""
    mean = np.empty(layer.weight.shape[1], np.float32)
    _sum_rows(layer.weight, mean)
    return Layer(layer.weight - mean / np.float32(len(layer.bias)), layer.bias - layer.bias.mean())


@_compiled
def _values(layers: Layers, advantage: Layer, outputs: Outputs, action: NDArray[np.int64]) -> Floats32:
    """Return Q of one action in each row (eq. 2.56), with the centered layer `advantage`."""
    q = np.empty(len(action), np.float32)
    for row in range(len(action)):
        value = layers.value.bias[0] + advantage.bias[action[row]]
        for column in range(outputs.value.shape[1]):
            value += layers.value.weight[0, column] * outputs.value[row, column]
        for column in range(outputs.advantage.shape[1]):
            value += advantage.weight[action[row], column] * outputs.advantage[row, column]
        q[row] = value
    return q


@_compiled
def _backward_output(
    layers: Layers,
    advantage: Layer,
    gradient: Layers,
    action: NDArray[np.int64],
    q_gradient: Floats32,
    outputs: Outputs,
    derivatives: Outputs,
) -> None:
    """Write the gradients of the last layers and the derivatives with respect to their inputs."""
    to_weight, to_bias = np.zeros_like(advantage.weight), np.zeros_like(advantage.bias)
    np.dot(q_gradient, outputs.value, gradient.value.weight[0])
    gradient.value.bias[0] = q_gradient.sum()
    for row in range(len(action)):
        chosen = action[row]
        to_bias[chosen] += q_gradient[row]
        for column in range(outputs.advantage.shape[1]):
            to_weight[chosen, column] += q_gradient[row] * outputs.advantage[row, column]
            derivatives.advantage[row, column] = q_gradient[row] * advantage.weight[chosen, column]
        for column in range(outputs.value.shape[1]):
            derivatives.value[row, column] = q_gradient[row] * layers.value.weight[0, column]
    centered = _centered(Layer(to_weight, to_bias))
    for row in range(len(to_bias)):
        gradient.advantage.bias[row] = centered.bias[row]
        for column in range(outputs.advantage.shape[1]):
            gradient.advantage.weight[row, column] = centered.weight[row, column]


@_compiled
def _backward_streams(
    layers: Layers, gradient: Layers, observation: Floats32, outputs: Outputs, derivatives: Outputs
) -> None:
    """Write the gradients of the hidden layers, from the last to the first."""
    last = len(layers.shared) - 1
    _backward_layer(gradient.value_hidden, outputs.shared[last], outputs.value, derivatives.value)
    _backward_layer(gradient.advantage_hidden, outputs.shared[last], outputs.advantage, derivatives.advantage)
    np.dot(derivatives.value, layers.value_hidden.weight, derivatives.shared[last])
    by_advantage = np.dot(derivatives.advantage, layers.advantage_hidden.weight)
    np.add(derivatives.shared[last], by_advantage, derivatives.shared[last])
    for depth in range(last, -1, -1):
        below = outputs.shared[depth - 1] if depth else observation
        _backward_layer(gradient.shared[depth], below, outputs.shared[depth], derivatives.shared[depth])
        if depth:
            np.dot(derivatives.shared[depth], layers.shared[depth].weight, derivatives.shared[depth - 1])


@_compiled
def _backward_layer(gradient: Layer, inputs: Floats32, outputs: Floats32, derivatives: Floats32) -> None:
    """Backpropagate the derivatives through the ReLU, in place, and write the gradient."""
    for row in range(len(outputs)):
        for column in range(outputs.shape[1]):
            if outputs[row, column] <= 0:
                derivatives[row, column] = 0
    np.dot(derivatives.T, inputs, gradient.weight)
    _sum_rows(derivatives, gradient.bias)


@_compiled
def _sum_rows(matrix: Floats32, total: Floats32) -> None:
    """Write the sum of the rows into `total`."""
    total.fill(0)
    for row in range(len(matrix)):
        for column in range(len(total)):
            total[column] += matrix[row, column]
