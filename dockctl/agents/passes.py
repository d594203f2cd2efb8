"""Forward and backward pass of the dueling network in matrices, without autograd and into given buffers.

Equation 2.56 is linear in the outputs of the last hidden layer, so the last layers of both streams act as one
matrix: its row of action a is [weights of the value, weights of the advantage of a less their mean over the
actions]. Learning needs one row of it for each transition; the greedy action needs the advantages alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from dockctl.agents.network import Layer, Layers


def buffers_for(layers: Layers, rows: int) -> list[Tensor]:
    """Room for the outputs of each hidden layer, (rows, outputs)."""
    return [layer.bias.new_empty(rows, len(layer.bias)) for layer in layers.hidden]


def hidden_outputs(layers: Layers, observation: Tensor, outputs: Sequence[Tensor] | None = None) -> Tensor:
    """Return the output of the last hidden layer; that of each layer is written into `outputs` if given."""
    below = observation
    for depth, layer in enumerate(layers.hidden):
        out = outputs[depth] if outputs else None
        below = torch.addmm(layer.bias, below, layer.weight.t(), out=out).relu_()
    return below


def greedy_action(layers: Layers, hidden: Tensor) -> Tensor:
    """Action of the highest value, (n, split + actions) -> (n,): that of the highest advantage."""
    last = layers.advantage
    return torch.addmm(last.bias, hidden[:, layers.split :], last.weight.t()).argmax(1)


def empty_output(layers: Layers) -> Layer:
    """Room for what `fold` writes: weight (actions, split + actions) and bias (actions,)."""
    bias = torch.empty_like(layers.advantage.bias)
    return Layer(bias.new_empty(len(bias), layers.split + len(bias)), bias)


def fold(layers: Layers, output: Layer) -> None:
    """Write the last layers of both streams, joined by eq. 2.56, as the one layer `output`."""
    value, advantage = layers.value, layers.advantage
    output.weight[:, : layers.split] = value.weight
    torch.sub(advantage.weight, advantage.weight.mean(0), out=output.weight[:, layers.split :])
    torch.sub(advantage.bias, advantage.bias.mean() - value.bias, out=output.bias)


def unfold(output: Layer, layers: Layers) -> None:
    """Turn the gradient of the folded layer into those of the last layers: the adjoint of `fold`."""
    value, advantage = layers.value, layers.advantage
    to_value, to_advantage = output.weight[:, : layers.split], output.weight[:, layers.split :]
    torch.sum(to_value, 0, keepdim=True, out=value.weight)
    torch.sum(output.bias, 0, keepdim=True, out=value.bias)
    torch.sub(to_advantage, to_advantage.mean(0), out=advantage.weight)
    torch.sub(output.bias, output.bias.mean(), out=advantage.bias)


def value_of(output: Layer, hidden: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
    """Q of one action a row, (n,), and the rows (n, split + actions) of the folded layer that gave it."""
    rows = output.weight.index_select(0, action)
    return torch.linalg.vecdot(hidden, rows) + output.bias.index_select(0, action), rows


def backward(
    layers: Layers, gradient: Layers, observation: Tensor, outputs: Sequence[Tensor], slopes: Sequence[Tensor]
) -> None:
    """Write the gradient of the hidden layers.

    Args:
        layers, gradient: parameters, and where their gradients go.
        observation, outputs: what `hidden_outputs` took and gave; the outputs are spent.
        slopes: derivatives of the loss by the outputs; the last ones are given, the others computed.
    """
    inputs = [observation, *outputs[:-1]]
    for depth in reversed(range(len(inputs))):
        slope = slopes[depth].mul_(outputs[depth].sign_())  # ReLU's own slope: 1 where its output is positive
        torch.mm(slope.t(), inputs[depth], out=gradient.hidden[depth].weight)
        torch.sum(slope, 0, out=gradient.hidden[depth].bias)
        if depth:
            torch.mm(slope, layers.hidden[depth].weight, out=slopes[depth - 1])
