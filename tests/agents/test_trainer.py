"""The training loop on a task that is learned in seconds: it learns, repeats, and can be taken up again."""

from __future__ import annotations

import csv
from pathlib import Path
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from dockctl.agents.checkpoint import CheckpointError, load_policy
from dockctl.agents.dqn.schedules import updates_due
from dockctl.agents.policy import GreedyPolicy
from dockctl.agents.progress import Progress
from dockctl.agents.trainer import Trainer
from dockctl.compute.threads import usable_cores, workers
from dockctl.evaluation.rollout import play
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.training import StopRule, Training
from tests.agents.toy import ToyDocking, starts_at

SETTINGS: dict[str, Any] = {
    "boats": 8, "hidden_sizes": (32, 32), "total_steps": 20_000, "warmup_steps": 200, "batch_size": 32,
    "steps_per_update": 8, "learning_rate": 2e-3, "reward_scale": 0.1, "replay_capacity": 10_000, "n_step": 3,
    "epsilon": {"decay_steps": 6_000}, "evaluate_every_steps": 1_000, "target_update_interval": 50,
}  # fmt: skip


def read_table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


TABLES = ("episodes.csv", "updates.csv", "evaluations.csv")


def trainer(root: Path, **changes: Any) -> Trainer:
    training = Training(**{**SETTINGS, **changes})
    run = RunDirectory.create(root, "toy", training.seed)
    return trainer_in(run, training)


def trainer_in(run: RunDirectory, training: Training, **options: Any) -> Trainer:
    judge = ToyDocking(2)
    starts = starts_at(-1.0, -0.9)
    return Trainer(
        training, "toy", ToyDocking(training.boats), lambda p: play(judge, p, starts), run, **options
    )


def test_it_learns_and_stops_when_the_task_is_mastered(tmp_path: Path) -> None:
    learner = trainer(tmp_path)
    assert learner.run() == "mastered"
    best, card = load_policy(learner.run_directory.path)
    assert card.env_steps <= learner.progress.env_steps
    starts = starts_at(*np.linspace(-1.1, -0.9, 9))
    assert all(episode.docked for episode in play(ToyDocking(4), GreedyPolicy(best), starts))
    rows = read_table(learner.run_directory.path / "episodes.csv")
    assert [int(row["episode"]) for row in rows] == list(range(1, len(rows) + 1))
    assert sum(row["outcome"] == "docked" for row in rows[-100:]) >= 95
    assert float(rows[-1]["return"]) == pytest.approx(10 + float(rows[-1]["reward_distance"]), abs=0.2)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(tmp_path: Path) -> None:
    runs = []
    for seed in (1, 1, 2):
        learner = trainer(tmp_path, seed=seed, total_steps=3_000, stop=None)
        assert learner.run() == "steps"
        runs.append(learner.run_directory.path)

    def contents(name: str) -> list[bytes]:
        return [(run / name).read_bytes() for run in runs]

    for name in (
        *TABLES,
        *(f"checkpoints/{k}/policy.{s}" for k in ("best", "last") for s in ("json", "safetensors")),
    ):
        first, second, other = contents(name)
        assert first == second, name
        assert first != other, name


def test_interrupted_and_taken_up_again(tmp_path: Path) -> None:
    def interrupt_at(steps: int) -> Trainer:
        run = RunDirectory.create(tmp_path, "toy", 0)
        training = Training(**{**SETTINGS, "total_steps": 4_000, "stop": None})
        learner = trainer_in(run, training, interrupted=lambda: learner.progress.env_steps >= steps)
        assert learner.run() == "interrupted"
        return learner

    def take_up(run: RunDirectory, total_steps: int) -> Trainer:
        learner = trainer_in(run, Training(**{**SETTINGS, "total_steps": total_steps, "stop": None}))
        learner.restore()
        return learner

    first, second = interrupt_at(1_600), interrupt_at(1_600)
    resumed = take_up(first.run_directory, 4_000)
    assert resumed.progress == first.progress
    for (name, kept), (_, restored) in zip(
        first.learner.online.named_parameters(), resumed.learner.online.named_parameters(), strict=True
    ):
        assert (kept == restored).all(), name
    same_batch = [t.replay.sample(64) for t in (first, resumed)]
    np.testing.assert_array_equal(same_batch[0].observation, same_batch[1].observation)
    same_update = [t.learner.update(same_batch[0], 1e-3) for t in (first, resumed)]
    assert same_update[0] == same_update[1]
    assert (first.learner.online.flat == resumed.learner.online.flat).all()

    results = []
    for run in (first.run_directory, second.run_directory):
        learner = take_up(run, 4_000)
        assert learner.run() == "steps"
        assert learner.progress.env_steps == 4_000
        assert learner.progress.updates == updates_due(learner.training, 4_000 - 8)
        results.append([(run.path / table).read_bytes() for table in TABLES])
    assert results[0] == results[1]
    steps = [int(row["env_steps"]) for row in read_table(first.run_directory.path / "evaluations.csv")]
    assert steps == sorted(steps)
    assert steps[-1] == 4_000


def test_nothing_is_learned_after_a_step_that_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hundreds of updates are due when the boats sink; at most the one under way is made."""
    made = trainer(tmp_path, steps_per_update=1, warmup_steps=200, boats=200)

    def step(action: Any) -> Any:
        if made.learner.updates:
            raise RuntimeError("the boats sank")
        return sail(action)

    sail = made.environment.step
    monkeypatch.setattr(made.environment, "step", step)
    with pytest.raises(RuntimeError, match="sank"):
        made.run()
    updates, together = made.learner.updates, Barrier(usable_cores())
    list(workers().map(lambda _: together.wait(), range(usable_cores())))  # every thread has come to its end
    assert 0 < made.learner.updates == updates


def test_rows_past_the_checkpoint_are_dropped_when_a_killed_run_is_taken_up(tmp_path: Path) -> None:
    learner = trainer(tmp_path, total_steps=1_000, stop=None)
    learner.run()
    path = learner.run_directory.path / "episodes.csv"
    whole = path.read_text()
    path.write_text(
        whole + whole.splitlines()[-1].replace(",1000,", ",1016,").replace("1000", "1016") + "\n9,12"
    )
    again = trainer_in(learner.run_directory, Training(**{**SETTINGS, "total_steps": 2_000, "stop": None}))
    again.restore()
    assert path.read_text() == whole


def test_restoring_without_a_checkpoint_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no such file"):
        trainer(tmp_path).restore()


def test_the_thesis_preset_makes_one_update_a_step(tmp_path: Path) -> None:
    training = Training(preset="thesis", total_steps=100, replay_capacity=1000, hidden_sizes=(8,))
    learner = trainer_in(RunDirectory.create(tmp_path, "toy", 0), training)
    seen: list[int] = []
    learner.on_progress = lambda progress: seen.append(progress.updates)
    learner.run()
    assert seen == [0] * 32 + list(range(1, 69))


def progress(docked: list[bool], own: list[bool], evaluation: tuple[int, int]) -> Progress:
    state = Progress(evaluation_docked=evaluation[0], evaluation_episodes=evaluation[1])
    for d, o in zip(docked, own, strict=True):
        state.count_episode("docked" if d else "timeout", o, keep=100)
    return state


@pytest.mark.parametrize(
    ("docked", "own", "evaluation", "mastered"),
    [
        ([True] * 10, [True] * 10, (1, 1), True),
        ([True] * 9, [True] * 9, (1, 1), False),  # too few episodes
        ([True] * 10, [True] * 10, (4, 5), False),  # the greedy policy misses a pose
        ([True] * 10, [True] * 10, (0, 0), False),  # no evaluation yet
        ([True] * 9 + [False], [False] * 10, (1, 1), True),  # 9 of 10 are asked for
        ([True] * 8 + [False] * 2, [False] * 10, (1, 1), False),
        ([True] * 9 + [False], [False] * 5 + [True] * 5, (1, 1), False),  # 4 of its own 5
        ([False] * 5 + [True] * 10, [True] * 15, (1, 1), True),  # long ago
    ],
)
def test_stop_rule(docked: list[bool], own: list[bool], evaluation: tuple[int, int], mastered: bool) -> None:
    assert progress(docked, own, evaluation).mastered(StopRule(docked=9, episodes=10)) is mastered


def test_episode_limit(tmp_path: Path) -> None:
    learner = trainer(tmp_path, max_episodes=5, stop=None)
    assert learner.run() == "episodes"
    assert learner.progress.episodes >= 5
