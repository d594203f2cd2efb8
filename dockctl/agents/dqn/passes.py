"""Forward and backward pass of the dueling network, compiled: products of matrices by BLAS, and loops.

Equation 2.56 is linear in the outputs of the last hidden layer, so the last layers of both streams act as one
matrix: its row of action a is [weights of the value, weights of the advantage of a less their mean over the
actions]. Learning needs one row of it for each transition; the greedy action needs the advantages alone.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy.linalg.cython_blas  # noqa: F401  # loads the BLAS that compiled code calls
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dockctl.agents.dqn.network import Floats, Layer, Layers
from dockctl.compute.jit import compiled

# Sums may be taken in any order, so that several of their terms are added by one instruction.
compiled_freely = compiled(error_model="numpy", fastmath={"arcp", "contract", "nsz", "reassoc"})


@cache
def hold_to_one_thread() -> None:
    """Keep BLAS from threads of its own: small matrices gain nothing, the other cores are the simulator's."""
    threadpool_limits(1, user_api="blas")


def room_for(layers: Layers, rows: int) -> tuple[Floats, ...]:
    """Return room for the outputs of each hidden layer, (rows, outputs)."""
    return tuple(np.zeros((rows, len(layer.bias)), np.float32) for layer in layers.hidden)


def room_for_output(layers: Layers) -> Layer:
    """Return room for what `fold` writes: weight (actions, split + actions) and bias (actions,)."""
    actions = len(layers.advantage.bias)
    return Layer(np.zeros((actions, layers.split + actions), np.float32), np.zeros(actions, np.float32))


@compiled_freely
def _rectified(layer: Layer, inputs: Floats, outputs: Floats) -> Floats:
    """Write max(0, x W^T + b) into `outputs`, and return them."""
    np.dot(inputs, layer.weight.T, outputs)
    for row in range(len(outputs)):
        for column in range(len(layer.bias)):
            outputs[row, column] = max(outputs[row, column] + layer.bias[column], np.float32(0))
    return outputs


@compiled_freely
def hidden_outputs(layers: Layers, observation: Floats, outputs: tuple[Floats, ...]) -> Floats:
    """Write the output of each hidden layer into `outputs`; return that of the last."""
    below = observation
    for depth in range(len(layers.hidden)):
        below = _rectified(layers.hidden[depth], below, outputs[depth])
    return below


@compiled_freely
def greedy_from(layers: Layers, hidden: Floats) -> NDArray[np.int64]:
    """Return the action of the highest value, (n, split + actions) -> (n,): that of the highest advantage."""
    rows, split, (weight, bias) = len(hidden), layers.split, layers.advantage
    features = np.empty((rows, len(bias)), np.float32)
    for row in range(rows):
        for column in range(len(bias)):
            features[row, column] = hidden[row, split + column]
    advantage = np.dot(features, weight.T)
    best = np.zeros(rows, np.int64)
    for row in range(rows):
        for action in range(len(bias)):
            if advantage[row, action] + bias[action] > advantage[row, best[row]] + bias[best[row]]:
                best[row] = action
    return best


@compiled_freely
def greedy_action(layers: Layers, observation: Floats) -> NDArray[np.int64]:
    """Return the action of the highest value, (n, observation_size) -> (n,)."""
    below = observation
    for depth in range(len(layers.hidden)):
        layer = layers.hidden[depth]
        below = _rectified(layer, below, np.empty((len(observation), len(layer.bias)), np.float32))
    return greedy_from(layers, below)


@compiled_freely
def fold(layers: Layers, output: Layer) -> None:
    """Write the last layers of both streams, joined by eq. 2.56, as the one layer `output`."""
    split, (value, value_bias), (advantage, bias) = layers.split, layers.value, layers.advantage
    folded, folded_bias, actions = output.weight, output.bias, len(bias)
    count = np.float32(actions)
    weight_sum, bias_sum = _sum_rows(advantage), _sum(bias)
    for action in range(actions):
        for column in range(split):
            folded[action, column] = value[0, column]
        for column in range(actions):
            folded[action, split + column] = advantage[action, column] - weight_sum[column] / count
        folded_bias[action] = value_bias[0] + bias[action] - bias_sum / count


@compiled_freely
def unfold(output: Layer, layers: Layers) -> None:
    """Turn the gradient of the folded layer into those of the last layers: the adjoint of `fold`."""
    split, (value, value_bias), (advantage, bias) = layers.split, layers.value, layers.advantage
    folded, folded_bias, actions = output.weight, output.bias, len(bias)
    count = np.float32(actions)
    weight_sum, bias_sum = _sum_rows(folded), _sum(folded_bias)
    value_bias[0] = bias_sum
    for column in range(split):
        value[0, column] = weight_sum[column]
    for action in range(actions):
        for column in range(actions):
            advantage[action, column] = folded[action, split + column] - weight_sum[split + column] / count
        bias[action] = folded_bias[action] - bias_sum / count


@compiled_freely
def backward(
    layers: Layers,
    gradient: Layers,
    observation: Floats,
    outputs: tuple[Floats, ...],
    slopes: tuple[Floats, ...],
) -> None:
    """Write the gradient of the hidden layers.

    Args:
        layers, gradient: parameters, and where their gradients go.
        observation, outputs: what `hidden_outputs` took and gave.
        slopes: derivatives of the loss by the outputs; the last ones are given, the others computed.
    """
    for depth in range(len(layers.hidden) - 1, -1, -1):
        slope, layer = slopes[depth], gradient.hidden[depth]
        _rectify(slope, outputs[depth])
        np.dot(slope.T, outputs[depth - 1] if depth else observation, layer.weight)
        bias = _sum_rows(slope)
        for column in range(len(bias)):
            layer.bias[column] = bias[column]
        if depth:
            np.dot(slope, layers.hidden[depth].weight, slopes[depth - 1])


@compiled_freely
def _rectify(slopes: Floats, outputs: Floats) -> None:
    """Take the slopes by max(0, x) back to slopes by x."""
    for row in range(len(slopes)):
        for column in range(slopes.shape[1]):
            slopes[row, column] = slopes[row, column] if outputs[row, column] > 0 else np.float32(0)


@compiled_freely
def _sum_rows(matrix: Floats) -> Floats:
    """Return the sum over the rows, (n, k) -> (k,)."""
    total = np.zeros(matrix.shape[1], np.float32)
    for row in range(len(matrix)):
        for column in range(len(total)):
            total[column] += matrix[row, column]
    return total


@compiled_freely
def _sum(vector: Floats) -> np.float32:
    total = np.float32(0)
    for i in range(len(vector)):
        total += vector[i]
    return total
