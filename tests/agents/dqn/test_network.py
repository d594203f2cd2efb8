"""The dueling network: size, aggregation, and parameters that are views of one vector."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dockctl.agents.dqn.network import DuelingQNetwork

HAND_COUNTED = {
    # shared 256-128-64; value 64 -> 64 -> 1; advantage 64 -> 77 -> 77; each layer with its biases
    15: 15 * 256 + 256 + 256 * 128 + 128 + 128 * 64 + 64 + 64 * 64 + 64 + 65 + 64 * 77 + 77 + 77 * 77 + 77,
    16: 60_740,
}


@pytest.mark.parametrize(("observation_size", "parameters"), HAND_COUNTED.items())
def test_parameter_count(observation_size: int, parameters: int) -> None:
    network = DuelingQNetwork(observation_size, 77)
    assert sum(parameter.numel() for parameter in network.parameters()) == parameters == len(network.flat)


def test_the_mean_over_the_actions_is_the_value() -> None:
    network = DuelingQNetwork(16, 77, generator=torch.Generator().manual_seed(3))
    observation = torch.randn(9, 16)
    value = network.value(network.shared(observation))
    torch.testing.assert_close(network(observation).mean(dim=1, keepdim=True), value)


def test_glorot_uniform_weights_and_zero_biases() -> None:
    network = DuelingQNetwork(16, 77, generator=torch.Generator().manual_seed(0))
    for name, parameter in network.named_parameters():
        if name.endswith("bias"):
            assert (parameter == 0).all()
        else:
            bound = (6 / sum(parameter.shape)) ** 0.5
            assert 0.9 * bound < parameter.abs().max() <= bound
            assert parameter.abs().mean().item() == pytest.approx(bound / 2, rel=0.2)


def test_the_generator_decides_the_weights() -> None:
    first, same, other = (
        DuelingQNetwork(4, 3, (8,), generator=torch.Generator().manual_seed(seed)).flat for seed in (1, 1, 2)
    )
    assert (first == same).all()
    assert (first != other).any()


def test_parameters_and_gradients_are_views_of_one_vector() -> None:
    network = DuelingQNetwork(4, 3, (8,))
    network(torch.ones(2, 4)).sum().backward()
    assert network.flat.grad is not None
    assert network.flat.grad.abs().sum() > 0
    for parameter in network.parameters():
        assert parameter.grad is not None
        for part, whole in ((parameter, network.flat), (parameter.grad, network.flat.grad)):
            assert part.untyped_storage().data_ptr() == whole.untyped_storage().data_ptr()
    assert sum(parameter.numel() for parameter in network.parameters()) == len(network.flat)
    network.flat.zero_()
    assert (network(torch.ones(1, 4)) == 0).all()


def test_layers_are_the_parameters_with_the_streams_side_by_side() -> None:
    network = DuelingQNetwork(5, 3, (8, 6), torch.Generator().manual_seed(0))
    network.flat += torch.arange(len(network.flat)) / 100
    layers = network.layers(network.flat.numpy())
    first, second, streams = layers.hidden
    pairs = [
        (network.shared[0], first.weight, first.bias),
        (network.shared[2], second.weight, second.bias),
        (network.value[0], streams.weight[:6], streams.bias[:6]),
        (network.advantage[0], streams.weight[6:], streams.bias[6:]),
        (network.value[2], layers.value.weight, layers.value.bias),
        (network.advantage[2], layers.advantage.weight, layers.advantage.bias),
    ]
    for module, weight, bias in pairs:
        np.testing.assert_array_equal(module.weight.detach().numpy(), weight)
        np.testing.assert_array_equal(module.bias.detach().numpy(), bias)
    assert layers.split == 6


def test_a_copy_has_parameters_of_its_own() -> None:
    network = DuelingQNetwork(5, 3, (8, 6), torch.Generator().manual_seed(0))
    copy, observation = network.copy_on(torch.device("cpu")), torch.ones(1, 5)
    torch.testing.assert_close(copy(observation), network(observation))
    copy.flat.zero_()
    assert (copy(observation) == 0).all()
    assert (network(observation) != 0).any()
