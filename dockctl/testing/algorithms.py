"""Contract test of algorithms."""

from __future__ import annotations

import copy
import json
import math
from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dockctl.agents.algorithms import AlgorithmSpec
from dockctl.agents.interface import Algorithm, Metrics, Overlapping, Policy, Spaces, Step, Tensors
from dockctl.plugins import ALGORITHMS
from dockctl.scenarios.training import Training
from dockctl.testing.contract import ContractError, Require, Rule, contract_of
from dockctl.testing.parts import BOATS, registered_spec

SAVED_AT, LEARNING_STEPS = 24, 36
FEATURES = Box(-1.0, 1.0, (5,), np.float32)


def check_algorithm(kind: str, action_space: Space[Any], **keys: Any) -> None:
    """Check the algorithm `kind` with these keys, on random steps.

    Actions are in the space; nothing is learned in the warm-up; metrics are finite; the same seed gives the
    same policy, also if an `Overlapping` algorithm learns one step late; the greedy policy is deterministic
    and can be rebuilt from its tensors; a restored algorithm continues as if it had not stopped.

    Args:
        kind: registered name.
        action_space: action space of one boat.
        keys: keys of ``training.algorithm``.
    """
    spec: AlgorithmSpec = registered_spec(ALGORITHMS, AlgorithmSpec, kind, keys)
    training = Training(
        algorithm=spec, boats=BOATS, total_steps=BOATS * LEARNING_STEPS,
        warmup_steps=BOATS * SAVED_AT // 2, batch_size=8, steps_per_update=BOATS, hidden_sizes=(8, 8),
        replay_capacity=1000, n_step=1, target_update_interval=2,
    )  # fmt: skip
    spaces = Spaces(FEATURES, action_space)
    first, second = (
        _learned(spec.build(spaces, training, "cpu"), spec, spaces, training, range(SAVED_AT))
        for _ in range(2)
    )
    require = contract_of(f"algorithm '{kind}'")
    require("valid", spec.describe(), "no description")
    require("valid", first.updates > 0, "performs no updates")
    _require_equal(require, "deterministic", first.policy_tensors(), second.policy_tensors())
    if isinstance(first, Overlapping) and first.acts_while_learning:
        late, ahead = (
            _learned(spec.build(spaces, training, "cpu"), spec, spaces, training, range(SAVED_AT), **how)
            for how in ({"late": 1}, {"ahead": 2})
        )
        _require_equal(require, "deterministic", first.policy_tensors(), late.policy_tensors())
        same = ahead.updates == first.updates
        require("valid", same, "learn repeats updates that it has made for later steps")

    _check_greedy(require, first, spec, spaces, training)

    given = first.policy_tensors()
    (tensors, facts), policy, updates = copy.deepcopy((first.state(), given, first.updates))
    try:
        written = json.dumps(facts)
    except (TypeError, ValueError) as error:
        raise ContractError(f"algorithm '{kind}'", "resumable", f"facts of its state: {error}") from error
    _learned(first, spec, spaces, training, range(SAVED_AT, LEARNING_STEPS))
    _check_greedy(require, first, spec, spaces, training)
    _require_equal(require, "unshared", policy, given)
    restored = spec.build(spaces, training, "cpu")
    restored.restore(policy, tensors, json.loads(written))
    require("resumable", restored.updates == updates, "restore changes the number of updates")
    _require_equal(require, "resumable", policy, restored.policy_tensors())
    _learned(restored, spec, spaces, training, range(SAVED_AT, LEARNING_STEPS))
    _require_equal(require, "resumable", first.policy_tensors(), restored.policy_tensors())


def _check_greedy(
    require: Require, algorithm: Algorithm, spec: AlgorithmSpec, spaces: Spaces, training: Training
) -> None:
    """Check the current greedy policy, and the policy that is rebuilt from its tensors."""
    observation = np.random.default_rng(1).uniform(-1, 1, (BOATS, 5)).astype(np.float32)

    def act(policy: Policy, rows: slice) -> NDArray[Any]:
        given = observation[rows].copy()
        policy.reset(np.arange(len(given)), {})
        actions = np.asarray(policy.act(given, {}))
        require("pure", np.array_equal(given, observation[rows]), "the policy changes the observation")
        _require_actions(require, actions, batch_space(spaces.action, len(given)))
        return actions

    actions = act(algorithm.policy, slice(None))
    again = act(algorithm.policy, slice(None))
    require("deterministic", np.array_equal(actions, again), "the policy is random")
    for rows in (slice(1), slice(2, 5), slice(None, None, -1)):
        same = np.allclose(actions[rows], act(algorithm.policy, rows))
        require("independent_rows", same, "an action depends on the other boats")
    rebuilt = spec.load_policy(algorithm.policy_tensors(), spaces, training.hidden_sizes)
    require("consistent", np.allclose(actions, act(rebuilt, slice(None))), "the rebuilt policy differs")


def _require_actions(require: Require, actions: NDArray[Any], space: Space[Any]) -> None:
    """Check the shape of actions, and that they are in a space after a cast to its type."""
    expected = space.shape
    require("shape", actions.shape == expected, f"actions of shape {actions.shape}, expected {expected}")
    typed = space.dtype is not None and np.can_cast(actions.dtype, space.dtype, "same_kind")
    inside = typed and space.contains(actions.astype(space.dtype))
    require("in_range", inside, f"actions {actions} are not in {space}")


def _learned(
    algorithm: Algorithm,
    spec: AlgorithmSpec,
    spaces: Spaces,
    training: Training,
    steps: range,
    *,
    late: int = 0,
    ahead: int = 0,
) -> Algorithm:
    """Return the algorithm after learning from random data, which is the same for the same steps.

    The iterator of a call to `learn` is consumed `late` steps later. In one of the steps, the updates of the
    next `ahead` steps are made as well.
    """
    learning: deque[Iterator[Metrics]] = deque()

    def consume(unfinished: int) -> None:
        while len(learning) > unfinished:
            for metrics in learning.popleft():
                require("valid", env_steps >= training.warmup_steps, "learns in the warm-up")
                require("valid", "loss" in metrics, f"metrics {[*metrics]} without 'loss'")
                for name, value in metrics.items():
                    require("finite", math.isfinite(value), f"{name} {value}")

    require, space = contract_of(f"algorithm '{spec.kind}'"), batch_space(spaces.action, BOATS)
    rng, stored = np.random.default_rng(steps.start), list[tuple[Step, Step]]()
    observation = rng.uniform(-1, 1, (BOATS, 5)).astype(np.float32)
    for step in steps:
        env_steps = step * BOATS
        before = observation.copy()
        action = np.asarray(algorithm.act(observation, env_steps))
        require("pure", np.array_equal(before, observation), "act changes the observation")
        _require_actions(require, action, space)
        learning.append(algorithm.learn(env_steps))
        if ahead and step == steps[3 * len(steps) // 4]:
            learning.append(algorithm.learn(env_steps + ahead * BOATS))
        consume(late)
        following = rng.uniform(-1, 1, observation.shape).astype(np.float32)
        terminated, truncated = rng.random((2, BOATS)) < 0.1
        made = Step(observation, action, rng.normal(size=BOATS), following, terminated, truncated)
        stored.append((made, copy.deepcopy(made)))
        algorithm.store(made)
        observation = following
    consume(0)
    for made, before_store in stored:
        for name, value in vars(made).items():
            require("pure", np.array_equal(value, vars(before_store)[name]), f"changes {name} of a step")
    return algorithm


def _require_equal(require: Require, rule: Rule, first: Tensors, second: Tensors) -> None:
    require(rule, first.keys() == second.keys(), "a different set of tensors")
    for name, tensor in first.items():
        require(
            "finite",
            tensor.dtype.kind in "biuf" and np.isfinite(tensor).all(),
            f"tensor {name} is not finite",
        )
        require(rule, np.array_equal(tensor, second[name]), f"tensor {name} differs")
