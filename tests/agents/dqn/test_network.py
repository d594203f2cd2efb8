"""The dueling network, its greedy policy, and exploration."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from dockctl.agents.dqn.algorithm import DQN
from dockctl.agents.dqn.network import DuelingQNetwork, widened
from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.agents.tensors import numpy_tensors
from dockctl.dueling import Ensemble, Mirror, join, shapes
from dockctl.scenarios.training import Training

HAND_COUNTED = {
    # shared 256-128-64; value 64 -> 64 -> 1; advantage 64 -> 77 -> 77; each layer with its biases
    15: 15 * 256 + 256 + 256 * 128 + 128 + 128 * 64 + 64 + 64 * 64 + 64 + 65 + 64 * 77 + 77 + 77 * 77 + 77,
    16: 60_740,
}


def greedy(network: DuelingQNetwork) -> GreedyPolicy:
    return GreedyPolicy(numpy_tensors(network.state_dict()))


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


def test_a_widened_network_computes_the_same_function() -> None:
    narrow = DuelingQNetwork(16, 77, (12, 9, 5), generator=torch.Generator().manual_seed(1))
    wide = DuelingQNetwork(16, 77, (20, 9, 31), generator=torch.Generator().manual_seed(2))
    own = wide.state_dict()
    for name, given in narrow.state_dict().items():
        own[name] = torch.from_numpy(widened(given.numpy(), own[name].numpy()))
    observation = torch.randn(50, 16, generator=torch.Generator().manual_seed(3))
    assert not torch.allclose(wide(observation), narrow(observation))
    wide.load_state_dict(own)
    torch.testing.assert_close(wide(observation), narrow(observation))


@pytest.mark.parametrize("shape", [(5,), (2, 4), (2, 6), (1, 1, 5)])
def test_observations_of_another_shape_are_rejected(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="shape"):
        greedy(DuelingQNetwork(5, 3, (8,))).act(np.zeros(shape, np.float32), {})


@pytest.mark.parametrize("hidden_sizes", [(8,), (256, 128, 64)])
def test_the_tensors_have_the_shapes_that_are_known_without_torch(hidden_sizes: tuple[int, ...]) -> None:
    network = DuelingQNetwork(5, 3, hidden_sizes)
    given = {name: tuple(tensor.shape) for name, tensor in network.state_dict().items()}
    assert shapes(5, 3, hidden_sizes) == given


def test_the_greedy_policy_computes_the_values_of_torch() -> None:
    network = DuelingQNetwork(16, 77, generator=torch.Generator().manual_seed(0))
    observation = np.random.default_rng(0).normal(size=(500, 16))
    with torch.no_grad():
        expected = network(torch.from_numpy(observation).float()).numpy()
    policy = greedy(network)
    found = policy.q_values(observation)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    chosen = policy.act(observation, {})
    np.testing.assert_array_equal(chosen, expected.argmax(axis=1))
    assert chosen.dtype == np.int64


def test_the_policy_of_the_algorithm_is_that_of_the_evaluated_network_as_it_is_now() -> None:
    dqn = DQN(5, 7, Training(hidden_sizes=(24, 12), replay_capacity=10), torch.device("cpu"))
    other = DuelingQNetwork(5, 7, (24, 12), torch.Generator().manual_seed(1))
    observation = np.random.default_rng(0).normal(size=(50, 5))
    dqn.learner.evaluated.load_state_dict(other.state_dict())
    np.testing.assert_array_equal(dqn.policy.act(observation, {}), greedy(other).act(observation, {}))


@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_exploration_is_as_frequent_as_epsilon(epsilon: float) -> None:
    rule = {"start": epsilon, "end": epsilon}
    dqn = DQN(5, 50, Training(hidden_sizes=(8, 8), replay_capacity=10, epsilon=rule), torch.device("cpu"))
    observation = np.ones((4000, 5), np.float32)
    explored = dqn.act(observation, 0) != dqn.policy.act(observation, {})
    assert explored.mean() == pytest.approx(epsilon * 49 / 50, abs=0.03)
    assert dqn.epsilon == epsilon


MIRROR = Mirror(np.array([0, 2, 1]), np.array([-1, 1, 1], np.float32), np.array([1, 0, 2, 3]))


def networks(count: int) -> list[DuelingQNetwork]:
    return [DuelingQNetwork(3, 4, (8,), torch.Generator().manual_seed(seed)) for seed in range(count)]


@pytest.mark.parametrize("mirror", [None, MIRROR])
@pytest.mark.parametrize("count", [1, 3])
def test_an_ensemble_has_the_mean_of_its_networks_and_of_the_mirror_images(
    count: int, mirror: Mirror | None
) -> None:
    observation = torch.randn(50, 3, generator=torch.Generator().manual_seed(9))
    image = observation[:, [0, 2, 1]] * torch.tensor([-1.0, 1.0, 1.0])
    with torch.no_grad():
        values = [network(observation) for network in networks(count)]
        if mirror:
            values += [network(image)[:, [1, 0, 2, 3]] for network in networks(count)]
    policy = GreedyPolicy(join([numpy_tensors(network.state_dict()) for network in networks(count)], mirror))
    np.testing.assert_allclose(
        policy.q_values(observation.numpy()), torch.stack(values).mean(0), rtol=1e-5, atol=1e-6
    )


def test_with_a_mirror_the_action_of_the_image_is_the_image_of_the_action() -> None:
    policy = GreedyPolicy(join([numpy_tensors(network.state_dict()) for network in networks(2)], MIRROR))
    observation = np.random.default_rng(0).normal(size=(200, 3)).astype(np.float32)
    action = policy.act(observation, {})
    assert len(set(action.tolist())) > 1
    np.testing.assert_array_equal(policy.act(MIRROR.observations(observation), {}), MIRROR.actions[action])


DAMAGE = {
    "a network is missing": lambda tensors: [tensors.pop(name) for name in [*tensors] if name[0] == "0"],
    "a layer is missing": lambda tensors: tensors.pop("1.value.0.bias"),
    "a network is of another size": lambda tensors: tensors.update(
        {
            f"1.{name}": array
            for name, array in numpy_tensors(DuelingQNetwork(3, 5, (8,)).state_dict()).items()
        }
    ),
    "a mirror of two actions as one": lambda tensors: tensors.update(
        {"mirror.actions": np.array([1, 1, 2, 3])}
    ),
    "a mirror of columns that do not exist": lambda tensors: tensors.update(
        {"mirror.columns": np.array([0, 1, 3])}
    ),
    "a mirror with numbers for columns": lambda tensors: tensors.update({"mirror.columns": np.arange(3.0)}),
    "a mirror with an array of another name": lambda tensors: tensors.update({"mirror.more": np.zeros(3)}),
    "a mirror without signs": lambda tensors: tensors.pop("mirror.signs"),
    "weights that are integers": lambda tensors: tensors.update(
        {"0.shared.0.weight": np.ones_like(tensors["0.shared.0.weight"], np.int32)}
    ),
    "complex weights": lambda tensors: tensors.update(
        {"0.shared.0.weight": tensors["0.shared.0.weight"] + 1j}
    ),
    "signs of another length": lambda tensors: tensors.update({"mirror.signs": np.ones(2, np.float32)}),
}


@pytest.mark.parametrize("name", DAMAGE)
def test_the_tensors_of_an_ensemble_are_checked(name: str) -> None:
    tensors = dict(join([numpy_tensors(network.state_dict()) for network in networks(2)], MIRROR))
    Ensemble.of(tensors)
    DAMAGE[name](tensors)
    with pytest.raises((KeyError, ValueError)):
        Ensemble.of(tensors)
