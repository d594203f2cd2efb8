"""Targets, loss, clipping, optimizers and target copies of the double DQN."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from dockctl.agents.dqn.compiled import DoubleDQN
from dockctl.agents.dqn.learner import Learner
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Transitions
from dockctl.agents.dqn.schedules import epsilon, learning_rate, updates_due
from dockctl.agents.dqn.update import AutogradDQN, Batch, q_of, td_loss, td_target
from dockctl.scenarios.training import Training

CPU = torch.device("cpu")


def batch(
    seed: int = 0, size: int = 32, reward: float = 1.0, observation_size: int = 4, actions: int = 3
) -> Transitions:
    rng = np.random.default_rng(seed)
    return Transitions(
        rng.normal(size=(size, observation_size)).astype(np.float32),
        rng.integers(actions, size=size),
        (reward * rng.normal(size=size)).astype(np.float32),
        rng.choice(np.array([0.0, 0.99], np.float32), size=size),
        rng.normal(size=(size, observation_size)).astype(np.float32),
    )


def network() -> DuelingQNetwork:
    return DuelingQNetwork(4, 3, (16, 8), torch.Generator().manual_seed(0))


def learner(**training: object) -> DoubleDQN:
    return DoubleDQN(network(), Training(**{"target_update_interval": 3, **training}))


def plain_learner(**training: object) -> AutogradDQN:
    return AutogradDQN(network(), Training(**{"target_update_interval": 3, **training}), CPU)


@settings(max_examples=60, deadline=None)
@given(
    size=st.integers(1, 40),
    observation_size=st.integers(1, 20),
    actions=st.integers(1, 12),
    hidden_sizes=st.lists(st.integers(1, 24), min_size=1, max_size=4),
    huber_delta=st.sampled_from([None, 0.1, 1.0, 10.0]),
    largest=st.sampled_from([None, 0.5]),
    seed=st.integers(0, 1000),
)
def test_loss_and_gradient_are_those_of_autograd(
    size: int,
    observation_size: int,
    actions: int,
    hidden_sizes: list[int],
    huber_delta: float | None,
    largest: float | None,
    seed: int,
) -> None:
    """Of every parameter, with random biases and a target network of its own."""
    generator = torch.Generator().manual_seed(seed)
    online, target = (DuelingQNetwork(observation_size, actions, hidden_sizes, generator) for _ in range(2))
    for made in (online, target):
        made.flat += 0.2 * torch.randn(made.flat.shape, generator=generator)
    bounds = {"largest_return": largest, "reward_scale": 1.0}
    dqn = DoubleDQN(online, Training(huber_delta=huber_delta, gradient_clip=None, **bounds))
    dqn.load({**dqn.state(), "target.flat": target.flat.numpy()}, 0)
    transitions = batch(seed, size, observation_size=observation_size, actions=actions)

    steps, bound = Batch.of(transitions, CPU), math.inf if largest is None else largest
    loss = td_loss(q_of(steps, online), td_target(steps, online, target, bound), huber_delta)
    torch.autograd.backward(loss)
    assert online.flat.grad is not None
    metrics = dqn.update(transitions, 1e-4)

    np.testing.assert_allclose(dqn.gradient, online.flat.grad.numpy(), rtol=1e-5, atol=1e-6)
    assert metrics.loss == pytest.approx(loss.item(), rel=1e-5, abs=1e-7)
    assert metrics.gradient_norm == pytest.approx(online.flat.grad.norm().item(), rel=1e-5, abs=1e-7)


@settings(max_examples=20, deadline=None)
@given(
    optimizer=st.sampled_from(["adam", "rmsprop"]),
    huber_delta=st.sampled_from([None, 1.0]),
    gradient_clip=st.sampled_from([None, 0.1]),
    seed=st.integers(0, 1000),
)
def test_both_learners_learn_the_same(
    optimizer: str, huber_delta: float | None, gradient_clip: float | None, seed: int
) -> None:
    """Twenty updates with six copies to the target network: the same metrics, parameters and moments."""
    settings = {"optimizer": optimizer, "huber_delta": huber_delta, "gradient_clip": gradient_clip}
    compiled, plain = learner(**settings), plain_learner(**settings)
    for number in range(20):
        ours, theirs = (dqn.update(batch(seed + number), 1e-3) for dqn in (compiled, plain))
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-5)
    torch.testing.assert_close(compiled.online.flat, plain.online.flat, rtol=1e-3, atol=1e-5)
    for name, moment in compiled.state().items():
        np.testing.assert_allclose(moment, plain.state()[name], rtol=1e-3, atol=1e-5, err_msg=name)


def test_metrics_by_hand() -> None:
    """Every next value is discounted away, so that the targets are the rewards."""
    dqn, transitions = learner(huber_delta=None), batch()
    transitions.discount[:] = 0
    with torch.no_grad():
        q = dqn.online(torch.from_numpy(transitions.observation))[range(32), transitions.action].numpy()
    metrics = dqn.update(transitions, 1e-3)
    assert metrics.td_error == pytest.approx(np.abs(q - transitions.reward).mean(), rel=1e-5)
    assert metrics.loss == pytest.approx(np.square(q - transitions.reward).mean(), rel=1e-5)
    assert metrics.q_mean == pytest.approx(q.mean(), rel=1e-4)
    assert not math.isnan(metrics.gradient_norm)


def test_double_and_plain_targets_differ_where_the_networks_disagree() -> None:
    """Online prefers action 0, target values it 1 and its own favourite, action 1, 5."""
    one = torch.zeros(1, 4)
    steps = Batch(one, torch.tensor([0]), torch.tensor([2.0]), torch.tensor([0.9]), one)

    def online(observation: Tensor) -> Tensor:
        return torch.tensor([[3.0, 2.0, 0.0]])

    def target(observation: Tensor) -> Tensor:
        return torch.tensor([[1.0, 5.0, 0.0]])

    assert td_target(steps, online, target).tolist() == pytest.approx([2 + 0.9 * 1])
    plain = steps.reward + steps.discount * target(one).max(dim=1).values
    assert plain.tolist() == pytest.approx([2 + 0.9 * 5])


def test_a_terminal_transition_is_worth_its_reward() -> None:
    one = torch.zeros(1, 4)
    steps = Batch(one, torch.tensor([0]), torch.tensor([-3.0]), torch.tensor([0.0]), one)
    network = DuelingQNetwork(4, 3, (8,))
    assert td_target(steps, network, network).tolist() == [-3.0]


def test_no_target_is_above_the_largest_return() -> None:
    one = torch.zeros(2, 4)
    steps = Batch(one, torch.tensor([0, 0]), torch.tensor([50.0, -50.0]), torch.tensor([0.9, 0.9]), one)

    def high(observation: Tensor) -> Tensor:
        return torch.full((2, 3), 100.0)

    assert td_target(steps, high, high, 60.0).tolist() == pytest.approx([60, -50 + 90])


def test_losses_by_hand() -> None:
    q, target = torch.tensor([0.0, 0.0]), torch.tensor([1.0, 4.0])
    assert td_loss(q, target, None).item() == pytest.approx((1 + 16) / 2)
    assert td_loss(q, target, 2.0).item() == pytest.approx((0.5 + 2 * (4 - 1)) / 2)


def test_the_target_network_is_copied_at_its_interval() -> None:
    dqn = learner()
    for update in range(1, 7):
        dqn.update(batch(update), 1e-2)
        assert bool((dqn.target == dqn.online.flat.numpy()).all()) is (update % 3 == 0)


def test_the_gradient_is_clipped_to_the_norm_and_its_own_norm_is_told() -> None:
    dqn = learner(gradient_clip=0.5, huber_delta=None)
    metrics = dqn.update(batch(reward=100.0), 1e-3)
    assert metrics.gradient_norm > 0.5
    assert np.linalg.norm(dqn.gradient) == pytest.approx(0.5, rel=1e-4)
    free = learner(gradient_clip=None, huber_delta=None)
    assert free.update(batch(reward=100.0), 1e-3).gradient_norm == metrics.gradient_norm
    assert np.linalg.norm(free.gradient) == pytest.approx(metrics.gradient_norm, rel=1e-5)


@pytest.mark.parametrize("optimizer", ["adam", "rmsprop"])
def test_one_vector_is_optimized_as_separate_parameters_are(optimizer: str) -> None:
    """By torch's own optimizers, each parameter apart."""
    dqn = learner(optimizer=optimizer, gradient_clip=None, huber_delta=1.0, target_update_interval=1000)
    plain, target = network(), network()
    peer: torch.optim.Optimizer
    if optimizer == "adam":
        peer = torch.optim.Adam(plain.parameters(), lr=1e-3)
    else:
        peer = torch.optim.RMSprop(plain.parameters(), lr=1e-3, alpha=0.9, eps=1e-7)
    for number in range(20):
        dqn.update(batch(number), 1e-3)
        steps = Batch.of(batch(number), CPU)
        peer.zero_grad(set_to_none=False)
        td_loss(q_of(steps, plain), td_target(steps, plain, target), 1.0).backward()
        peer.step()
    torch.testing.assert_close(dqn.online.flat, plain.flat, rtol=1e-4, atol=1e-6)


def test_keras_rmsprop_by_hand() -> None:
    """First step: v = 0.1 g^2, so every weight moves by lr * g / (sqrt(0.1) |g| + 1e-7)."""
    dqn = learner(optimizer="rmsprop", gradient_clip=None)
    before = dqn.online.flat.clone()
    dqn.update(batch(), 1e-4)
    gradient = torch.from_numpy(dqn.gradient).double()
    expected = -1e-4 * gradient / ((0.1 * gradient**2).sqrt() + 1e-7)
    torch.testing.assert_close((dqn.online.flat - before).double(), expected, rtol=1e-2, atol=2e-8)


@pytest.mark.parametrize("optimizer", ["adam", "rmsprop"])
@pytest.mark.parametrize("make", [learner, plain_learner])
def test_a_restored_learner_goes_on_as_the_old_one(make: Callable[..., Learner], optimizer: str) -> None:
    old, new = make(optimizer=optimizer), make(optimizer=optimizer)
    for number in range(5):
        old.update(batch(number), 1e-3)
    state = {name: value.copy() for name, value in old.state().items()}
    new.online.flat.copy_(old.online.flat)
    new.load(state, old.updates)
    for number in range(5, 9):
        assert old.update(batch(number), 1e-3) == new.update(batch(number), 1e-3)
    assert (old.online.flat == new.online.flat).all()


@pytest.mark.parametrize("optimizer", ["adam", "rmsprop"])
def test_a_learner_goes_on_where_one_of_the_other_kind_stopped(optimizer: str) -> None:
    """A training that was begun on another device."""
    plain, compiled = plain_learner(optimizer=optimizer), learner(optimizer=optimizer)
    for number in range(5):
        plain.update(batch(number), 1e-3)
    compiled.online.flat.copy_(plain.online.flat)
    compiled.load({name: value.copy() for name, value in plain.state().items()}, plain.updates)
    for number in range(5, 9):
        expected = plain.update(batch(number), 1e-3)
        assert compiled.update(batch(number), 1e-3) == pytest.approx(expected, rel=1e-3, abs=1e-5)


@pytest.mark.parametrize("optimizer", ["adam", "rmsprop"])
def test_moments_of_silent_units_fade_to_zero_not_to_denormal_numbers(optimizer: str) -> None:
    dqn, nothing = learner(optimizer=optimizer), np.zeros(len(network().flat), np.float32)
    dqn.update(batch(), 1e-3)
    parameters = dqn.online.flat.numpy()
    for _ in range(3000):
        dqn.optimizer.step(parameters, nothing, 1e-3)
    fading = dqn.optimizer.moments["first" if optimizer == "adam" else "second"]
    assert not fading.any()


def test_schedules() -> None:
    training = Training(total_steps=1000, epsilon={"start": 1.0, "end": 0.1, "decay_steps": 500})
    assert [epsilon(training, t) for t in (0, 250, 500, 900)] == pytest.approx([1, 0.55, 0.1, 0.1])
    assert [learning_rate(training, t) for t in (0, 500, 1000)] == pytest.approx([5e-4, 2.75e-4, 5e-5])
    assert [updates_due(training, t) for t in (4999, 5000, 5015, 5016)] == [0, 1, 1, 2]
