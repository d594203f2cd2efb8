"""Algorithms and policies that break a rule are rejected."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from dockctl import testing
from dockctl.agents.dqn.algorithm import DQN
from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.testing.contract import Rule
from tests.testing.rejection import assert_rejected


def test_an_algorithm_whose_policy_explores_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng()
    monkeypatch.setattr(GreedyPolicy, "act", lambda self, rows, info: rng.integers(7, size=len(rows)))
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), "deterministic")


@pytest.mark.parametrize(
    ("act", "rule"),
    [
        (lambda rows: np.full(len(rows), 7), "in_range"),
        (lambda rows: np.full(len(rows), 3.4), "in_range"),
        (lambda rows: np.full(len(rows), np.nan), "in_range"),
        (lambda rows: np.zeros((len(rows), 1), int), "shape"),
        (lambda rows: rows.__imul__(0)[:, 0].astype(int), "pure"),
        (lambda rows: np.arange(len(rows)), "independent_rows"),
        (lambda rows: (np.roll(rows, 1, axis=0)[:, 0] > 0).astype(int), "independent_rows"),
    ],
)
def test_a_faulty_greedy_policy_is_rejected(monkeypatch: pytest.MonkeyPatch, act: Any, rule: str) -> None:
    monkeypatch.setattr(GreedyPolicy, "act", lambda self, rows, info: act(rows))
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), rule)


def test_a_policy_that_is_not_the_newest_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    newest, first = DQN.policy, dict[int, Any]()

    def stale(algorithm: DQN) -> Any:
        return first.setdefault(id(algorithm), newest.__get__(algorithm))

    monkeypatch.setattr(DQN, "policy", property(stale))
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), "consistent")


@pytest.mark.parametrize("lost", ["exploration", "replay"])
def test_an_algorithm_whose_state_is_incomplete_is_rejected(
    monkeypatch: pytest.MonkeyPatch, lost: str
) -> None:
    restore = DQN.restore

    def restore_without(algorithm: DQN, policy: Any, tensors: Any, facts: Any) -> None:
        blank = copy.deepcopy(vars(algorithm)[lost])
        restore(algorithm, policy, tensors, facts)
        vars(algorithm)[lost] = blank

    monkeypatch.setattr(DQN, "restore", restore_without)
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), "resumable")


def learn_without_loss(algorithm: DQN, env_steps: int) -> Any:
    for metrics in LEARN(algorithm, env_steps):
        yield {"td_error": metrics["td_error"]}


def learn_without_q(algorithm: DQN, env_steps: int) -> Any:
    for metrics in LEARN(algorithm, env_steps):
        yield {**metrics, "q_mean": np.nan}


def learn_again(algorithm: DQN, env_steps: int) -> Any:
    """Also what it has learned ahead."""
    algorithm._scheduled = algorithm.training.updates_due(env_steps - algorithm.training.boats)
    return LEARN(algorithm, env_steps)


def store_and_change(algorithm: DQN, step: Any) -> None:
    STORE(algorithm, step)
    step.next_observation[:] = 0


def state_with_numpy(algorithm: DQN) -> Any:
    tensors, facts = STATE(algorithm)
    return tensors, {**facts, "scale": np.float32(1)}


def act_as_the_next_boat(policy: GreedyPolicy, observation: Any, info: Any) -> Any:
    return np.arange(len(observation))[::-1]


def tensors_that_are_in_use(algorithm: DQN) -> Any:
    live = algorithm.learner.evaluated.state_dict()
    return {name: live[name].numpy() if name in live else value for name, value in TENSORS(algorithm).items()}


LEARN, STORE, STATE, TENSORS = DQN.learn, DQN.store, DQN.state, DQN.policy_tensors


@pytest.mark.parametrize(
    ("owner", "method", "broken", "rule"),
    [
        (DQN, "learn", learn_without_loss, "valid"),
        (DQN, "learn", learn_without_q, "finite"),
        (DQN, "learn", learn_again, "valid"),
        (DQN, "store", store_and_change, "pure"),
        (DQN, "state", state_with_numpy, "resumable"),
        (DQN, "policy_tensors", tensors_that_are_in_use, "unshared"),
        (GreedyPolicy, "act", act_as_the_next_boat, "independent_rows"),
    ],
)
def test_an_algorithm_that_breaks_a_rule_is_rejected(
    monkeypatch: pytest.MonkeyPatch, owner: type[Any], method: str, broken: Any, rule: Rule
) -> None:
    monkeypatch.setattr(owner, method, broken)
    assert_rejected(lambda: testing.check_algorithm("dqn", Discrete(7)), rule)


def test_a_policy_that_mixes_boats_is_rejected() -> None:
    class Largest:
        def reset(self, rows: Any, info: Any) -> None:
            pass

        def act(self, observation: Any, info: Any) -> Any:
            return np.full(len(observation), int(1e3 * np.abs(observation[:, 1]).max()) % 77)

    assert_rejected(lambda: testing.check_policy(Largest(), DockingVectorEnv("s1", 3)), "independent_rows")


def test_a_policy_that_forgets_boats_that_continue_is_rejected() -> None:
    class Counting:
        def reset(self, rows: Any, info: Any) -> None:
            self.steps = 0

        def act(self, observation: Any, info: Any) -> Any:
            self.steps += 1
            return np.full(len(observation), self.steps)

    assert_rejected(lambda: testing.check_policy(Counting(), DockingVectorEnv("s1", 3)), "independent_rows")
