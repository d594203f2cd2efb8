"""Algorithms of Stable-Baselines3 in the trainer: they learn, leave a normal run folder, and resume."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dockctl.agents.checkpoint import load_policy
from dockctl.evaluation.rollout import run_episodes
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.training import Training
from tests.agents.test_trainer import SETTINGS, TABLES, read_table, trainer_in
from tests.agents.toy import ToyDocking, starts_at

pytest.importorskip("stable_baselines3")

DQN: dict[str, Any] = {**SETTINGS, "algorithm": {"kind": "sb3"}, "n_step": 1}


@pytest.mark.slow
def test_dqn_learns(tmp_path: Path) -> None:
    learner = trainer_in(RunDirectory.create(tmp_path, "toy", 0), Training(**DQN))
    assert learner.run() == "mastered"
    policy, card = load_policy(learner.run_directory.path)
    assert card.algorithm["model"] == "DQN"
    starts = starts_at(*np.linspace(-1.1, -0.9, 9))
    assert all(episode.docked for episode in run_episodes(ToyDocking(4), policy, starts))
    rows = read_table(learner.run_directory.path / "updates.csv")
    assert all(float(row["loss"]) >= 0 for row in rows)
    assert float(rows[-1]["learning_rate"]) < float(rows[0]["learning_rate"])


def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    runs = []
    for _ in range(2):
        training = Training(**{**DQN, "total_steps": 1_500, "stop": None})
        learner = trainer_in(RunDirectory.create(tmp_path, "toy", 0), training)
        learner.run()
        runs.append(learner.run_directory.path)
    for name in (*TABLES, "checkpoints/last/policy.safetensors"):
        assert len({(run / name).read_bytes() for run in runs}) == 1, name


def test_a_resumed_training_restores_its_networks_and_starts_with_an_empty_replay(tmp_path: Path) -> None:
    run = RunDirectory.create(tmp_path, "toy", 0)
    first = trainer_in(run, Training(**{**DQN, "total_steps": 1_200, "stop": None}))
    first.run()
    second = trainer_in(run, Training(**{**DQN, "total_steps": 2_400, "stop": None}))
    second.restore()
    for name, tensor in first.algorithm.policy_tensors().items():
        np.testing.assert_array_equal(tensor, second.algorithm.policy_tensors()[name], err_msg=name)
    saved, restored = (trainer.algorithm.state()[0] for trainer in (first, second))
    assert saved.keys() == restored.keys()
    for name in saved:
        np.testing.assert_array_equal(saved[name], restored[name], err_msg=name)
    before = first.algorithm.updates
    assert second.run() == "steps"
    rows = [row for row in read_table(run.path / "updates.csv") if int(row["env_steps"]) > 1_200]
    assert int(rows[0]["env_steps"]) >= 1_200 + SETTINGS["warmup_steps"]
    assert int(rows[0]["update"]) == before + 1
