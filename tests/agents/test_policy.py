"""The greedy policy is the network's argmax; the epsilon-greedy one departs from it as it is told."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from dockctl.agents.dqn import passes
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.policy import EpsilonGreedyPolicy, GreedyPolicy


def network(seed: int, hidden_sizes: tuple[int, ...] = (24, 12), actions: int = 7) -> DuelingQNetwork:
    generator = torch.Generator().manual_seed(seed)
    made = DuelingQNetwork(5, actions, hidden_sizes, generator)
    made.flat += 0.2 * torch.randn(made.flat.shape, generator=generator)
    return made


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 1000),
    boats=st.integers(1, 33),
    hidden_sizes=st.lists(st.integers(1, 40), min_size=1, max_size=4).map(tuple),
    actions=st.integers(1, 80),
)
def test_the_greedy_action_is_the_networks(
    seed: int, boats: int, hidden_sizes: tuple[int, ...], actions: int
) -> None:
    made = network(seed, hidden_sizes, actions)
    observation = np.random.default_rng(seed).normal(size=(boats, 5)).astype(np.float32)
    with torch.no_grad():
        q = made(torch.from_numpy(observation)).numpy()
    chosen = GreedyPolicy(made).act(observation, {})
    assert chosen.dtype == np.int64
    np.testing.assert_allclose(q[np.arange(boats), chosen], q.max(axis=1), rtol=1e-5, atol=1e-5)
    clear = np.ptp(np.sort(q, axis=1)[:, -2:], axis=1) > 1e-4
    np.testing.assert_array_equal(chosen[clear], q.argmax(axis=1)[clear])


def test_the_folded_output_layer_gives_the_networks_values() -> None:
    made = network(3)
    observation = np.random.default_rng(4).normal(size=(6, 5)).astype(np.float32)
    layers = made.layers(made.flat.numpy())
    output = passes.room_for_output(layers)
    passes.fold(layers, output)
    hidden = passes.hidden_outputs(layers, observation, passes.room_for(layers, 6))
    with torch.no_grad():
        expected = made(torch.from_numpy(observation)).numpy()
    np.testing.assert_allclose(hidden @ output.weight.T + output.bias, expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", [(5,), (2, 4), (2, 6), (1, 1, 5)])
def test_observations_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=r"shape \(n, 5\), not"):
        GreedyPolicy(network(0)).act(np.zeros(shape, np.float32), {})


def test_the_policy_follows_the_network_as_it_learns() -> None:
    made, other = network(0), network(1)
    policy, observation = GreedyPolicy(made), np.random.default_rng(0).normal(size=(50, 5)).astype(np.float32)
    before, after = policy.act(observation, {}), GreedyPolicy(other).act(observation, {})
    assert (before != after).any()
    made.flat.copy_(other.flat)
    np.testing.assert_array_equal(policy.act(observation, {}), after)


@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_exploration_is_as_frequent_as_epsilon(epsilon: float) -> None:
    policy = EpsilonGreedyPolicy(network(1, actions=50), np.random.default_rng(0))
    observation = np.ones((4000, 5), np.float32)
    departed = policy(observation, epsilon) != policy.greedy.act(observation, {})
    assert departed.mean() == pytest.approx(epsilon * 49 / 50, abs=0.03)
