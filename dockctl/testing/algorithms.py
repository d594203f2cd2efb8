"""Contract test for learning algorithms."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector.utils import batch_space

from dockctl.agents.algorithms import AlgorithmSpec
from dockctl.agents.interface import Algorithm, Spaces, Step, Tensors
from dockctl.plugins import ALGORITHMS
from dockctl.scenarios import catalog
from dockctl.scenarios.training import Training

BOATS, STEPS = 4, 24
OBSERVATIONS = Box(-1.0, 1.0, (5,), np.float32)


def check_algorithm(kind: str, action_space: Space[Any], **keys: Any) -> None:
    """Check the algorithm `kind` with these keys, on random steps.

    Actions are in the space; nothing is learned in the warm-up; metrics are finite; the same seed gives the
    same policy; the greedy policy is deterministic and can be rebuilt from its tensors; a restored algorithm
    continues with the same policy and number of updates.

    Args:
        kind: registered name.
        action_space: of one boat.
        keys: of ``training.algorithm``.
    """
    catalog.fill()
    spec = ALGORITHMS.get(kind).value.model_validate({"kind": kind, **keys})
    assert isinstance(spec, AlgorithmSpec), f"algorithm '{kind}' is not an AlgorithmSpec"
    assert type(spec).model_validate(spec.model_dump(mode="json")) == spec, f"'{kind}': the dump differs"
    training = Training(
        algorithm=spec, boats=BOATS, total_steps=BOATS * STEPS, warmup_steps=BOATS * STEPS // 2,
        batch_size=8, steps_per_update=BOATS, hidden_sizes=(8, 8), replay_capacity=1000, n_step=1,
    )  # fmt: skip
    spaces = Spaces(OBSERVATIONS, action_space)
    first, second = (_trained(spec, spaces, training) for _ in range(2))
    what = f"algorithm '{kind}'"
    assert first.updates > 0, f"{what} makes no updates"
    _require_equal(first.policy_tensors(), second.policy_tensors(), f"{what}: the same seed gives another")

    observation = np.random.default_rng(1).uniform(-1, 1, (BOATS, 5)).astype(np.float32)
    actions = first.policy.act(observation, {})
    assert np.array_equal(actions, first.policy.act(observation, {})), f"{what}: the policy is random"
    rebuilt = spec.load_policy(first.policy_tensors(), spaces, training.hidden_sizes)
    assert np.allclose(actions, rebuilt.act(observation, {})), f"{what}: the rebuilt policy differs"

    tensors, facts = first.state()
    restored = spec.build(spaces, training, "cpu")
    restored.restore(first.policy_tensors(), tensors, json.loads(json.dumps(facts)))
    assert restored.updates == first.updates, f"{what}: restore changes the number of updates"
    _require_equal(first.policy_tensors(), restored.policy_tensors(), f"{what}: restore gives another")


def _trained(spec: AlgorithmSpec, spaces: Spaces, training: Training) -> Algorithm:
    """Return an algorithm that learned from random observations and rewards."""
    algorithm = spec.build(spaces, training, "cpu")
    what, space = f"algorithm '{spec.kind}'", batch_space(spaces.action, BOATS)
    rng = np.random.default_rng(0)
    observation = rng.uniform(-1, 1, (BOATS, 5)).astype(np.float32)
    for step in range(STEPS):
        env_steps = step * BOATS
        before = observation.copy()
        action = np.asarray(algorithm.act(observation, env_steps))
        assert np.array_equal(before, observation), f"{what}: act changes the observation"
        assert space.contains(action.astype(space.dtype)), f"{what}: actions {action} are not in {space}"
        for metrics in algorithm.learn(env_steps):
            assert env_steps >= training.warmup_steps, f"{what} learns in the warm-up"
            assert math.isfinite(metrics["loss"]), f"{what}: loss {metrics['loss']}"
        following = rng.uniform(-1, 1, observation.shape).astype(np.float32)
        terminated, truncated = rng.random((2, BOATS)) < 0.1
        algorithm.store(Step(observation, action, rng.normal(size=BOATS), following, terminated, truncated))
        observation = following
    return algorithm


def _require_equal(first: Tensors, second: Tensors, what: str) -> None:
    assert first.keys() == second.keys(), f"{what} set of tensors"
    for name, tensor in first.items():
        assert np.array_equal(tensor, second[name]), f"{what} {name}"
