"""Hysteresis of a greedy policy: which action it recognizes as its last one, and when it changes it."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.agents.interface import Spaces
from dockctl.dueling import Ensemble, Hysteresis, join, shapes, split
from dockctl.envs.hysteresis import action_hysteresis
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import InputError
from dockctl.experiments.dry_run import build_algorithm, dry_run
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.loader import load
from dockctl.sim.world import NothingInRange, in_open_water

FORCES, ANGLES = range(-50, 51, 10), range(-30, 31, 10)


def policy_with(values: list[float], hysteresis: Hysteresis) -> GreedyPolicy:
    """Return a policy whose three action values are constant."""
    network = {name: np.zeros(shape, np.float32) for name, shape in shapes(2, 3, (4,)).items()}
    last = max(name for name in network if name.startswith("advantage") and name.endswith("bias"))
    network[last][:] = values
    return GreedyPolicy(join([network], hysteresis=hysteresis))


def test_an_action_is_kept_until_another_one_is_better_by_the_margin() -> None:
    commands = np.array([[-1, 0], [0, 0], [1, 0]], np.float32)
    hysteresis = Hysteresis(np.array([0, 1]), commands, np.array([0.5, 0, 0.5], np.float32))
    observed = np.array([[-1, 0], [0, 0], [1, 0], [0.9, 0], [1, 0.2]], np.float32)  # the last commands
    for values, expected in {
        (0.0, 0.1, 0.4): [0, 2, 2, 2, 2],  # the margin keeps the first action, and none keeps the second
        (0.0, 0.1, 0.6): [2, 2, 2, 2, 2],
        (0.6, 0.1, 0.0): [0, 0, 0, 0, 0],
        (0.4, 0.1, 0.0): [0, 0, 2, 0, 0],
    }.items():
        assert policy_with(list(values), hysteresis).act(observed, {}).tolist() == expected


def test_in_every_step_the_last_action_of_the_simulator_is_recognized() -> None:
    loaded = load("s3")
    hysteresis = Hysteresis(*action_hysteresis(loaded.scenario, 0.7))
    assert hysteresis.margin.reshape(11, 7)[:, 0].tolist() == pytest.approx([0.7] * 5 + [0] + [0.7] * 5)
    nothing = NothingInRange(loaded.scenario.sensors.lidar)
    env = DockingVectorEnv(loaded, 77, worlds=[in_open_water(nothing)])
    observation, _ = env.reset(seed=0)
    at_rest = hysteresis.bonus(observation)
    assert (at_rest == 0).all()  # no action has been taken
    for shift in range(2):
        actions = (np.arange(77) + 5 * shift) % 77
        observation, *_ = env.step(actions)
        bonus = hysteresis.bonus(observation)
        thrust = np.array([force != 0 for force in FORCES for _ in ANGLES])[actions]
        assert (bonus[np.arange(77), actions] == np.where(thrust, np.float32(0.7), 0)).all()
        assert np.count_nonzero(bonus) == thrust.sum()  # and no other action


def test_a_checkpoint_has_it() -> None:
    spaces = Spaces(Box(-1, 1, (16,)), Discrete(77))
    algorithm = build_algorithm(load("s3", overrides=["training.hysteresis=600"]), spaces, 1, "cpu")
    networks, mirror, hysteresis = split(algorithm.policy_tensors())
    assert (len(networks), mirror) == (1, None)
    assert hysteresis is not None
    assert hysteresis.margin.max() == pytest.approx(0.6)  # of the scaled rewards
    assert Ensemble.of(algorithm.policy_tensors()).hysteresis is not None


@pytest.mark.parametrize(
    ("change", "part"),
    [("actions.kind=incremental", "'incremental'"), ("observation=[distance, lidar]", "command")],
)
def test_what_it_needs(change: str, part: str) -> None:
    loaded = load("s3", overrides=[change, "training.hysteresis=600"])
    with pytest.raises(FieldError, match=part):
        action_hysteresis(loaded.scenario, 1.0)
    with pytest.raises(InputError) as caught:
        dry_run(loaded)
    (problem,) = caught.value.problems
    assert (problem.file, problem.code) == ("--set training.hysteresis", "mismatch")


def test_an_algorithm_whose_policy_cannot_keep_actions() -> None:
    changes = ["training.algorithm.kind=sb3", "training.hysteresis=1", "training.replay_capacity=1000"]
    spaces = Spaces(Box(-1, 1, (15,)), Discrete(77))
    with pytest.raises(InputError) as caught:
        build_algorithm(load("s1", overrides=changes), spaces, 1, "cpu")
    assert caught.value.problems[0].file == "--set training.hysteresis"


@pytest.mark.parametrize("damage", ["columns", "shape", "missing"])
def test_a_damaged_one_is_refused(damage: str) -> None:
    network = {name: np.zeros(shape, np.float32) for name, shape in shapes(2, 3, (4,)).items()}
    columns = np.array([0, 7 if damage == "columns" else 1])
    margin = np.zeros(4 if damage == "shape" else 3, np.float32)
    tensors = dict(join([network], hysteresis=Hysteresis(columns, np.zeros((3, 2), np.float32), margin)))
    if damage == "missing":
        del tensors["hysteresis.margin"]
    with pytest.raises(ValueError, match="hysteresis"):
        Ensemble.of(tensors)
