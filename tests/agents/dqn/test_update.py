"""Targets, loss, clipping, optimizers and target copies of double DQN."""

from __future__ import annotations

import copy

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from dockctl.agents.dqn.compiled import CompiledSteps
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Batch, Transitions
from dockctl.agents.dqn.update import AutogradSteps, DoubleDQN, td_loss, td_target, to_tensors
from dockctl.scenarios.training import Training

CPU = torch.device("cpu")


def batch(
    seed: int = 0, size: int = 32, reward: float = 1.0, observation_size: int = 4, actions: int = 3
) -> Batch:
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


def flat(network: torch.nn.Module) -> Tensor:
    return torch.nn.utils.parameters_to_vector(network.parameters()).detach().clone()


def gradient(network: torch.nn.Module) -> Tensor:
    return torch.cat([parameter.grad.reshape(-1) for parameter in network.parameters()])


def test_metrics_by_hand() -> None:
    """All discounts are zero, so that the targets are the rewards."""
    dqn, transitions = learner(huber_delta=None), batch()
    transitions.discount[:] = 0
    with torch.no_grad():
        q = dqn.online(torch.from_numpy(transitions.observation))[range(32), transitions.action].numpy()
    metrics = dqn.update(transitions, 1e-3)[0]
    assert metrics["td_error"] == pytest.approx(np.abs(q - transitions.reward).mean(), rel=1e-5)
    assert metrics["loss"] == pytest.approx(np.square(q - transitions.reward).mean(), rel=1e-5)
    assert metrics["q_mean"] == pytest.approx(q.mean(), rel=1e-4)


def test_the_gradient_is_that_of_finite_differences() -> None:
    """Along random directions, in double precision; the target is constant."""
    dqn, transitions = learner(gradient_clip=None, huber_delta=1.0), batch()
    before = flat(dqn.online)
    dqn.update(transitions, 0.0)
    taken = gradient(dqn.online).double()
    assert (flat(dqn.online) == before).all()  # a learning rate of zero
    probe, steps = network().double(), to_tensors(transitions, CPU)
    double = Transitions(
        **{n: v.double() if v.is_floating_point() else v for n, v in steps._asdict().items()}
    )
    target = td_target(double, probe, probe)

    def loss(parameters: Tensor) -> float:
        torch.nn.utils.vector_to_parameters(parameters, probe.parameters())
        q = probe(double.observation).gather(1, double.action[:, None]).squeeze(1)
        return td_loss(q, target, 1.0).item()

    for seed in range(5):
        direction = torch.randn(len(before), generator=torch.Generator().manual_seed(seed)).double()
        h = 1e-6
        directional_derivative = (
            loss(before.double() + h * direction) - loss(before.double() - h * direction)
        ) / (2 * h)
        assert directional_derivative == pytest.approx((taken @ direction).item(), rel=1e-3, abs=1e-5)


@given(
    sizes=st.tuples(st.integers(1, 9), st.integers(1, 9), st.tuples(st.integers(1, 20), st.integers(1, 20))),
    rows=st.integers(1, 40),
    training=st.fixed_dictionaries(
        {
            "huber_delta": st.sampled_from([None, 0.5, 10.0]),
            "largest_return": st.sampled_from([0.3, None]),
            "gradient_clip": st.sampled_from([None, 0.01, 10.0]),
            "optimizer": st.sampled_from(["adam", "rmsprop"]),
        }
    ),
    seed=st.integers(0, 2**31),
)
def test_the_compiled_step_is_that_of_autograd(
    sizes: tuple[int, int, tuple[int, int]], rows: int, training: dict[str, object], seed: int
) -> None:
    """Metrics, clipped gradients and moments, also after the moments are restored."""
    observation_size, actions, hidden_sizes = sizes
    generator = torch.Generator().manual_seed(seed)
    online = DuelingQNetwork(observation_size, actions, hidden_sizes, generator)
    for parameter in online.parameters():  # biases other than zero
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=generator)
    settings = Training(reward_scale=1.0, target_update_interval=1000, **training)
    compiled, reference = DoubleDQN(online, settings), DoubleDQN(copy.deepcopy(online), settings)
    reference.steps = AutogradSteps(reference.online, reference.target, reference.acting, settings)
    for update in range(3):
        for fast, slow in zip(
            (compiled.online, compiled.target), (reference.online, reference.target), strict=True
        ):
            slow.load_state_dict(fast.state_dict())
        for learner in (compiled, reference):
            learner.steps.load_moments(compiled.steps.moments())
        transitions = batch(seed + update, rows, 3.0, observation_size, actions)
        expected = reference.update(transitions, 1e-3)[0]
        assert compiled.update(transitions, 1e-3)[0] == pytest.approx(expected, rel=1e-4, abs=1e-5)
        largest = float(gradient(reference.online).abs().max())
        torch.testing.assert_close(
            gradient(compiled.online), gradient(reference.online), rtol=1e-3, atol=1e-5 * (1 + largest)
        )
        moments, wanted = compiled.steps.moments(), reference.steps.moments()
        assert moments.keys() == wanted.keys()
        for name, values in wanted.items():
            np.testing.assert_allclose(moments[name], values, rtol=1e-2, atol=1e-5 * (1 + largest) ** 2)


def test_double_and_plain_targets_differ_where_the_networks_disagree() -> None:
    """The online network prefers action 0, which the target network values 1; its own best is worth 5."""
    one = torch.zeros(1, 4)
    steps = Transitions(one, torch.tensor([0]), torch.tensor([2.0]), torch.tensor([0.9]), one)

    def online(observation: Tensor) -> Tensor:
        return torch.tensor([[3.0, 2.0, 0.0]])

    def target(observation: Tensor) -> Tensor:
        return torch.tensor([[1.0, 5.0, 0.0]])

    assert td_target(steps, online, target).tolist() == pytest.approx([2 + 0.9 * 1])


def test_the_target_of_a_terminal_transition_is_its_reward() -> None:
    one = torch.zeros(1, 4)
    steps = Transitions(one, torch.tensor([0]), torch.tensor([-3.0]), torch.tensor([0.0]), one)
    network = DuelingQNetwork(4, 3, (8,))
    assert td_target(steps, network, network).tolist() == [-3.0]


def test_no_target_is_above_the_largest_return() -> None:
    one = torch.zeros(2, 4)
    steps = Transitions(one, torch.tensor([0, 0]), torch.tensor([50.0, -50.0]), torch.tensor([0.9, 0.9]), one)

    def high(observation: Tensor) -> Tensor:
        return torch.full((2, 3), 100.0)

    assert td_target(steps, high, high, 60.0).tolist() == pytest.approx([60, -50 + 90])


def test_the_evaluated_network_is_the_average_of_the_copies() -> None:
    """The first four copies weigh the same, later ones 1/4 when they are made."""
    dqn, copies = learner(averaged_copies=4), list[Tensor]()
    for seed in range(21):
        dqn.update(batch(seed), 1e-2)
        if dqn.updates % 3 == 0:
            copies.append(flat(dqn.online))
    weights = [*[0.25 * 0.75**3] * 4, 0.25 * 0.75**2, 0.25 * 0.75, 0.25]
    expected = sum(weight * copied for weight, copied in zip(weights, copies, strict=True))
    assert flat(dqn.evaluated).numpy() == pytest.approx(expected.numpy(), rel=1e-5, abs=1e-7)


def test_snapshots_of_the_evaluated_network_are_kept_for_an_ensemble() -> None:
    """Every 8 environment steps are 2 updates of 4 steps each, and the next copy is due after 3."""
    for every_steps, copies in ((8, 1), (12, 1), (24, 2), (36, 3)):
        ensemble = {"networks": 3, "every_steps": every_steps}
        dqn, expected = learner(averaged_copies=4, steps_per_update=4, ensemble=ensemble), list[Tensor]()
        for seed in range(24):
            dqn.update(batch(seed), 1e-2)
            if dqn.updates % (3 * copies) == 0:
                expected = [flat(dqn.evaluated).clone(), *expected][:2]
        assert len(dqn.snapshots) == 2
        for snapshot, parameters in zip(dqn.snapshots, expected, strict=True):
            given = np.concatenate([array.ravel() for array in snapshot.values()])
            np.testing.assert_array_equal(given, parameters)


@pytest.mark.parametrize("steps", [AutogradSteps, CompiledSteps])
def test_a_new_part_is_learned_like_the_first_and_the_networks_of_the_one_before_are_kept(
    steps: type,
) -> None:
    """With averages, moments of the optimizer and snapshots; both with 15 updates and 5 copies."""
    ensemble = {"networks": 3, "every_steps": 12, "restarts": 1}
    dqn = learner(averaged_copies=4, steps_per_update=4, ensemble=ensemble)
    dqn.steps = steps(dqn.online, dqn.target, dqn.acting, dqn.training)
    networks = dict[int, list[np.ndarray]]()
    for part in (0, 1):
        if part:
            dqn.begin(part)
        for seed in range(15):
            dqn.update(batch(seed), 1e-2)
        kept = [torch.nn.utils.parameters_to_vector(map(torch.from_numpy, s.values())) for s in dqn.snapshots]
        networks[part] = [each.numpy().copy() for each in (flat(dqn.evaluated), *kept)]
    assert len(dqn.finished) == len(networks[1]) == 3
    for first, again, finished in zip(networks[0], networks[1], dqn.finished, strict=True):
        np.testing.assert_array_equal(np.concatenate([a.ravel() for a in finished.values()]), first)
        np.testing.assert_array_equal(again, first)


def test_the_evaluated_network_without_averaging() -> None:
    dqn = learner(averaged_copies=None)
    dqn.update(batch(), 1e-2)
    assert dqn.evaluated is dqn.online


def test_losses_by_hand() -> None:
    q, target = torch.tensor([0.0, 0.0]), torch.tensor([1.0, 4.0])
    assert td_loss(q, target, None).item() == pytest.approx((1 + 16) / 2)
    assert td_loss(q, target, 2.0).item() == pytest.approx((0.5 + 2 * (4 - 1)) / 2)


def test_the_target_network_is_copied_at_its_interval() -> None:
    dqn = learner()
    for update in range(1, 7):
        dqn.update(batch(update), 1e-2)
        assert bool((flat(dqn.target) == flat(dqn.online)).all()) is (update % 3 == 0)


@pytest.mark.parametrize("steps", [AutogradSteps, CompiledSteps])
def test_several_steps_at_once_are_those_one_at_a_time(steps: type) -> None:
    """Also the metrics and the copies to the target network, of which two are due."""
    at_once, one_by_one = learner(), learner()
    for dqn in (at_once, one_by_one):
        dqn.steps = steps(dqn.online, dqn.target, dqn.acting, dqn.training)
    batches = [batch(seed, reward=100.0) for seed in range(7)]
    joined = Transitions(*(np.concatenate(arrays) for arrays in zip(*batches, strict=True)))
    metrics = at_once.update(joined, 1e-2, 7)
    assert metrics == [one_by_one.update(each, 1e-2)[0] for each in batches]
    for name in ("online", "target"):
        assert (flat(getattr(at_once, name)) == flat(getattr(one_by_one, name))).all()
    assert not (flat(at_once.online) == flat(at_once.target)).all()


def test_the_gradient_is_clipped_and_its_norm_before_clipping_is_reported() -> None:
    clipped, free = (learner(gradient_clip=clip, huber_delta=None) for clip in (0.5, None))
    metrics, unclipped = (dqn.update(batch(reward=100.0), 1e-3)[0] for dqn in (clipped, free))
    assert metrics["gradient_norm"] == unclipped["gradient_norm"] > 0.5
    assert gradient(clipped.online).norm().item() == pytest.approx(0.5, rel=1e-4)
    assert gradient(free.online).norm().item() == pytest.approx(unclipped["gradient_norm"], rel=1e-5)


def test_adam_by_hand() -> None:
    """Two steps of algorithm 1 of Kingma and Ba (2015), in double precision."""
    dqn = learner(optimizer="adam", gradient_clip=None)
    expected, mean, square = flat(dqn.online).double(), 0.0, 0.0
    for step in (1, 2):
        dqn.update(batch(step), 1e-3)
        g = gradient(dqn.online).double()
        mean, square = 0.9 * mean + 0.1 * g, 0.999 * square + 0.001 * g**2
        expected -= 1e-3 * (mean / (1 - 0.9**step)) / ((square / (1 - 0.999**step)).sqrt() + 1e-8)
    torch.testing.assert_close(flat(dqn.online).double(), expected, rtol=1e-4, atol=1e-7)


def test_keras_rmsprop_by_hand() -> None:
    """First step: v = 0.1 g^2, so every weight moves by lr * g / (sqrt(0.1) |g| + 1e-7)."""
    dqn = learner(optimizer="rmsprop", gradient_clip=None)
    before = flat(dqn.online)
    dqn.update(batch(), 1e-4)
    g = gradient(dqn.online).double()
    expected = -1e-4 * g / ((0.1 * g**2).sqrt() + 1e-7)
    torch.testing.assert_close((flat(dqn.online) - before).double(), expected, rtol=1e-2, atol=2e-8)


def test_schedules() -> None:
    training = Training(
        total_steps=1000, steps_per_update=16, epsilon={"start": 1.0, "end": 0.1, "decay_steps": 500}
    )
    assert [training.epsilon.at(t) for t in (0, 250, 500, 900)] == pytest.approx([1, 0.55, 0.1, 0.1])
    assert [training.learning_rate_at(t) for t in (0, 500, 1000)] == pytest.approx([5e-4, 2.75e-4, 5e-5])
    assert [training.updates_due(t) for t in (4999, 5000, 5015, 5016)] == [0, 1, 1, 2]


def test_the_learning_rate_of_each_part() -> None:
    training = Training(total_steps=1200, ensemble={"restarts": 2})
    assert [training.part_at(t) for t in (0, 399, 400, 799, 800, 1200)] == [0, 0, 1, 1, 2, 2]
    rates = [training.learning_rate_at(t) for t in (0, 200, 400, 600, 1000, 1200)]
    assert rates == pytest.approx([5e-4, 2.75e-4, 5e-4, 2.75e-4, 2.75e-4, 5e-5])
