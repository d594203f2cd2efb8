"""Algorithms of Stable-Baselines3 in the trainer: they learn, leave a normal run folder, and resume."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box, Discrete

from dockctl.agents.checkpoint import load_policy
from dockctl.agents.interface import Spaces, Step
from dockctl.agents.trainer import Trainer
from dockctl.evaluation.rollout import run_episodes
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.training import Training
from tests.agents.stops import finish, new_run, stop_at
from tests.agents.test_trainer import SETTINGS, TABLES, read_table, trainer_in
from tests.agents.toy import ToyDocking, starts_at

pytest.importorskip("stable_baselines3")

DQN: dict[str, Any] = {**SETTINGS, "algorithm": {"kind": "sb3"}, "n_step": 1}


@pytest.mark.slow
@pytest.mark.thorough  # a long training; short ones are below
def test_dqn_learns(tmp_path: Path) -> None:
    learner = trainer_in(RunDirectory.create(tmp_path, "toy", 0), Training(**DQN))
    assert learner.run() == "mastered"
    policy, card = load_policy(learner.run_directory.path)
    assert card.algorithm["model"] == "DQN"
    starts = starts_at(*np.linspace(-1.1, -0.9, 9))
    assert all(episode.docked for episode in run_episodes(ToyDocking(4, autoreset=False), policy, starts))
    rows = read_table(learner.run_directory.path / "updates.csv")
    assert all(float(row["loss"]) >= 0 for row in rows)
    assert float(rows[-1]["learning_rate"]) < float(rows[0]["learning_rate"])


def test_the_logger_makes_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    spaces = Spaces(Box(-1, 1, (2,), np.float32), Discrete(3))
    training = Training(**DQN)
    training.algorithm.build(spaces, training, "cpu")
    assert not [*tmp_path.glob("SB3*")]


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    runs = []
    for _ in range(2):
        training = Training(**{**DQN, "total_steps": 1_500, "stop": None})
        learner = trainer_in(RunDirectory.create(tmp_path, "toy", 0), training)
        learner.run()
        runs.append(learner.run_directory.path)
    for name in (*TABLES, "checkpoints/last/policy.safetensors"):
        assert len({(run / name).read_bytes() for run in runs}) == 1, name


def test_a_resumed_training_gives_the_bytes_of_the_uninterrupted_one(tmp_path: Path) -> None:
    training = Training(**{**DQN, "total_steps": 1_200, "replay_capacity": 800, "stop": None})

    def make(run: RunDirectory, **options: Any) -> Trainer:
        return trainer_in(run, training, **options)

    whole = finish(new_run(tmp_path), make)
    run = new_run(tmp_path)
    for steps in (304, 616, 1_000):
        stop_at(steps, run, make)
    resumed = finish(run, make)
    assert [name for name in resumed if resumed[name] != whole[name]] == []


@pytest.mark.parametrize(
    "hyperparameters",
    [{"optimize_memory_usage": True, "replay_buffer_kwargs": {"handle_timeout_termination": False}}],
)
def test_what_the_library_cannot_do_is_an_error(hyperparameters: dict[str, Any]) -> None:
    algorithm = {"kind": "sb3", "hyperparameters": hyperparameters}
    training = Training(**{**DQN, "algorithm": algorithm, "n_step": 3})
    with pytest.raises(FieldError, match="optimize_memory_usage"):
        training.algorithm.build(Spaces(Box(-1, 1, (2,), np.float32), Discrete(3)), training, "cpu")


def test_policy_arguments_may_be_null() -> None:
    training = Training(**{**DQN, "algorithm": {"kind": "sb3", "hyperparameters": {"policy_kwargs": None}}})
    training.algorithm.build(Spaces(Box(-1, 1, (2,), np.float32), Discrete(3)), training, "cpu")


def test_returns_end_where_new_episodes_begin() -> None:
    """After a rollback the next step does not continue the last one, which has no end of an episode."""
    training = Training(**{**DQN, "n_step": 3, "boats": 1, "gamma": 0.5, "reward_scale": 1.0})
    algorithm = training.algorithm.build(Spaces(Box(-1, 1, (1,), np.float32), Discrete(3)), training, "cpu")
    at = [0.1, 0.2, 0.3, -0.5, -0.4, -0.3]
    for now, after in ((0, 1), (1, 2), (3, 4), (4, 5)):
        observation, following = (np.array([[at[i]]], np.float32) for i in (now, after))
        algorithm.act(observation, 0)
        no = np.zeros(1, bool)
        algorithm.store(Step(observation, np.zeros(1, int), np.ones(1), following, no, no))
    replay = algorithm.model.replay_buffer
    assert replay is not None
    samples = replay._get_samples(np.array([0, 1, 2, 3]))
    assert samples.rewards[:, 0].tolist() == [1.5, 1.0, 1.5, 1.0]
    assert samples.next_observations[:, 0].tolist() == pytest.approx([0.3, 0.3, -0.3, -0.3])
    assert not samples.dones.any()


def test_the_noise_of_state_dependent_exploration_is_restored() -> None:
    algorithm = {"kind": "sb3", "model": "SAC", "hyperparameters": {"use_sde": True}}
    training = Training(**{**DQN, "algorithm": algorithm, "warmup_steps": 8})
    spaces = Spaces(Box(-1, 1, (2,), np.float32), Box(-1, 1, (1,), np.float32))
    first, second = (training.algorithm.build(spaces, training, "cpu") for _ in range(2))
    observation = np.full((training.boats, 2), 0.5, np.float32)
    for _ in range(2):  # the second model has drawn other noise since
        second.model.actor.reset_noise()
    assert not np.array_equal(second.act(observation, 1_000), first.act(observation, 1_000))
    second.restore(first.policy_tensors(), *first.state())
    assert np.array_equal(second.act(observation, 1_000), first.act(observation, 1_000))
