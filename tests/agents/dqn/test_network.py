"""The dueling network, its greedy policy, and exploration."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dockctl.agents.dqn.algorithm import DQN
from dockctl.agents.dqn.network import DuelingQNetwork, GreedyPolicy
from dockctl.scenarios.training import Training

HAND_COUNTED = {
    # shared 256-128-64; value 64 -> 64 -> 1; advantage 64 -> 77 -> 77; each layer with its biases
    15: 15 * 256 + 256 + 256 * 128 + 128 + 128 * 64 + 64 + 64 * 64 + 64 + 65 + 64 * 77 + 77 + 77 * 77 + 77,
    16: 60_740,
}


@pytest.mark.parametrize(("observation_size", "parameters"), HAND_COUNTED.items())
def test_parameter_count(observation_size: int, parameters: int) -> None:
    network = DuelingQNetwork(observation_size, 77)
    assert sum(parameter.numel() for parameter in network.parameters()) == parameters


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
        DuelingQNetwork(4, 3, (8,), generator=torch.Generator().manual_seed(seed)).value[0].weight
        for seed in (1, 1, 2)
    )
    assert (first == same).all()
    assert (first != other).any()


@pytest.mark.parametrize("shape", [(5,), (2, 4), (2, 6), (1, 1, 5)])
def test_observations_of_another_shape_are_rejected(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        GreedyPolicy(DuelingQNetwork(5, 3, (8,))).act(np.zeros(shape, np.float32), {})


def test_the_greedy_policy_follows_the_network_as_it_learns() -> None:
    network, other = (DuelingQNetwork(5, 7, (24, 12), torch.Generator().manual_seed(i)) for i in (0, 1))
    policy, observation = GreedyPolicy(network), np.random.default_rng(0).normal(size=(50, 5))
    network.load_state_dict(other.state_dict())
    with torch.no_grad():
        best = other(torch.from_numpy(observation).float()).argmax(dim=1).numpy()
    chosen = policy.act(observation, {})
    np.testing.assert_array_equal(chosen, best)
    assert chosen.dtype == np.int64


@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_exploration_is_as_frequent_as_epsilon(epsilon: float) -> None:
    rule = {"start": epsilon, "end": epsilon}
    dqn = DQN(5, 50, Training(hidden_sizes=(8, 8), replay_capacity=10, epsilon=rule), torch.device("cpu"))
    observation = np.ones((4000, 5), np.float32)
    explored = dqn.act(observation, 0) != dqn.policy.act(observation, {})
    assert explored.mean() == pytest.approx(epsilon * 49 / 50, abs=0.03)
    assert dqn.epsilon == epsilon
