"""The training loop on tasks that are learned in seconds: it learns, repeats, and resumes."""

from __future__ import annotations

import csv
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from dockctl.agents.background_learning import BackgroundLearning
from dockctl.agents.checkpoint import CheckpointError, PolicyCard, load_policy
from dockctl.agents.interface import Policy, Spaces
from dockctl.agents.progress import Progress, UpdateRecorder
from dockctl.agents.trainer import Trainer
from dockctl.compute import on_all_cores
from dockctl.errors import DockctlError
from dockctl.evaluation.rollout import evaluation_rows, run_episodes
from dockctl.runs.directory import RunDirectory
from dockctl.runs.tables import Value
from dockctl.scenarios.training import StopRule, Training
from tests.agents.toy import ToyDocking, starts_at

SETTINGS: dict[str, Any] = {
    "boats": 8, "hidden_sizes": (32, 32), "total_steps": 20_000, "warmup_steps": 200, "batch_size": 32,
    "steps_per_update": 8, "learning_rate": 2e-3, "reward_scale": 0.1, "replay_capacity": 10_000, "n_step": 3,
    "epsilon": {"decay_steps": 6_000}, "evaluate_every_steps": 1_000,
    "validation": {"every_steps": 1_000}, "target_update_interval": 50,
}  # fmt: skip


def read_table(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


TABLES = ("episodes.csv", "updates.csv", "evaluations.csv")


def trainer(root: Path, **changes: Any) -> Trainer:
    training = Training(**{**SETTINGS, **changes})
    run = RunDirectory.create(root, "toy", training.seed)
    return trainer_in(run, training)


def trainer_in(run: RunDirectory, training: Training, **options: Any) -> Trainer:
    greedy, starts = ToyDocking(2, autoreset=False), starts_at(-1.0, -0.9)

    def validate(policy: Policy) -> list[dict[str, Value]]:
        return evaluation_rows(run_episodes(greedy, policy, starts))

    environment = ToyDocking(training.boats)
    spaces = Spaces.from_env(environment)
    algorithm = training.algorithm.build(spaces, training, "cpu")
    options = {"validate": validate, **options}
    return Trainer(algorithm, training, environment, run, make_card(spaces, training), **options)


def make_card(spaces: Spaces, training: Training) -> PolicyCard:
    algorithm = training.algorithm.model_dump(mode="json")
    shared = {"hidden_sizes": training.hidden_sizes, "seed": training.seed, "algorithm": algorithm}
    return PolicyCard.for_spaces(spaces, scenario="toy", **shared)


def test_it_learns_until_the_stop_rule_is_met(tmp_path: Path) -> None:
    learner = trainer(tmp_path)
    assert learner.run() == "mastered"
    best, card = load_policy(learner.run_directory.path)
    assert card.env_steps <= learner.progress.env_steps
    starts = starts_at(*np.linspace(-1.1, -0.9, 9))
    assert all(episode.docked for episode in run_episodes(ToyDocking(4, autoreset=False), best, starts))
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


def test_best_docks_from_the_most_validation_starts_and_of_equal_ones_is_the_latest(tmp_path: Path) -> None:
    results = iter([2, 4, 3, 4, 1])  # of 4 starts; the returns favor the earlier ones

    def validate(policy: Policy) -> list[dict[str, Value]]:
        docked, worth = next(results), -learner.progress.env_steps
        outcomes = ["docked"] * docked + ["timeout"] * (4 - docked)
        return [{"start_kind": "validation", "outcome": outcome, "return": worth} for outcome in outcomes]

    def evaluate(policy: Policy) -> list[dict[str, Value]]:
        return [{"start_kind": "pose", "outcome": "timeout", "return": 0.0}]

    training = Training(**{**SETTINGS, "total_steps": 4_400, "evaluate_every_steps": 500, "stop": None})
    run = RunDirectory.create(tmp_path, "toy", 0)
    learner = trainer_in(run, training, validate=validate, evaluate=evaluate)
    learner.run()
    assert load_policy(run.path)[1].env_steps == 4_000
    rows = read_table(run.path / "evaluations.csv")
    validated = {int(row["env_steps"]): row["best"] for row in rows if row["start_kind"] == "validation"}
    assert validated == {1_000: "1", 2_000: "1", 3_000: "0", 4_000: "1", 4_400: "0"}
    evaluated = [int(row["env_steps"]) for row in rows if row["start_kind"] == "pose"]
    assert evaluated == [504, 1_000, 1_504, 2_000, 2_504, 3_000, 3_504, 4_000, 4_400]


def test_training_continues_until_enough_validation_starts_dock(tmp_path: Path) -> None:
    """The pose is docked from long before; of 20 validation starts 18 are too few, 19 are 95 %."""
    docked = [18, 18, 19]

    def validate(policy: Policy) -> list[dict[str, Value]]:
        now = docked.pop(0) if len(docked) > 1 else docked[0]
        outcomes = ["docked"] * now + ["timeout"] * (20 - now)
        return [{"start_kind": "validation", "outcome": outcome, "return": 0.0} for outcome in outcomes]

    def evaluate(policy: Policy) -> list[dict[str, Value]]:
        return [{"start_kind": "pose", "outcome": "docked", "return": 0.0}]

    training = Training(**{**SETTINGS, "validation": {"every_steps": 100_000}})
    run = RunDirectory.create(tmp_path, "toy", 0)
    learner = trainer_in(run, training, validate=validate, evaluate=evaluate)
    assert learner.run() == "mastered"
    rows = read_table(run.path / "evaluations.csv")
    at = sorted({int(row["env_steps"]) for row in rows if row["start_kind"] == "validation"})
    assert docked == [19]
    assert len(at) in (3, 4)  # the policy of the last step is validated as well
    assert all(later - earlier >= training.evaluate_every_steps for earlier, later in pairwise(at[:3]))


def test_the_policy_at_the_end_is_validated(tmp_path: Path) -> None:
    learner = trainer(tmp_path, total_steps=800, stop=None)
    learner.run()
    assert load_policy(learner.run_directory.path)[1].env_steps == 800


def test_nothing_is_learned_after_a_step_that_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The updates that were due before the step are made, and no others."""
    made = trainer(tmp_path, steps_per_update=1, warmup_steps=200, boats=200, evaluate_every_steps=2_000)

    def step(action: Any) -> Any:
        if made.progress.env_steps == 1_000:
            raise RuntimeError("the step failed")
        return original(action)

    original = made.environment.step
    monkeypatch.setattr(made.environment, "step", step)
    with pytest.raises(RuntimeError, match="the step failed"):
        made.run()
    assert made.algorithm.updates == made.training.updates_due(1_000) == 801


def test_updates_are_made_ahead_while_a_policy_is_evaluated(tmp_path: Path) -> None:
    """Those of a step in every five scans of a boat, for up to one percent of all steps, which are 200.

    Then each step makes three quarters of its updates until the steps have caught up.
    """
    made, ahead, updates = trainer(tmp_path, steps_per_update=2, stop=None), list[int](), list[int]()

    def on_progress(progress: Progress) -> None:
        ahead.append(progress.learned_steps - progress.env_steps)
        updates.append(progress.updates)

    made.on_progress = on_progress
    made.run()
    steps = defaultdict[int, list[int]](list)  # of the episodes of each evaluation
    for row in read_table(made.run_directory.path / "evaluations.csv"):
        steps[int(row["env_steps"])].append(int(row["steps"]))
    every = 1_000 // 8  # steps of 8 boats between two evaluations
    seen = set[int]()
    for evaluation in range(1, 19):
        last = evaluation * every - 1  # the step after which the policy is evaluated
        scans = 2 * max(steps[1_000 * evaluation])  # of two boats
        expected = min(8 * (scans // 5), 200)
        assert ahead[last : last + 4] == [expected - 2 * i if expected > 2 * i else -8 for i in range(4)]
        assert updates[last] == made.training.updates_due(1_000 * evaluation + expected)
        assert ahead[last + expected // 2 + 4 : last + every] == [-8] * (every - expected // 2 - 4)
        seen.add(expected)
    assert len(seen) > 1
    assert made.algorithm.updates == made.training.updates_due(20_000 - 8)


@pytest.mark.parametrize(("scans", "expected"), [(0, 0), (4, 0), (5, 1), (124, 24), (125, 25), (1_000, 25)])
def test_only_updates_that_begin_during_the_evaluation_are_made(
    tmp_path: Path, scans: int, expected: int
) -> None:
    made = trainer(tmp_path, steps_per_update=2, stop=None)
    made.progress.env_steps, made.progress.learned_steps = 1_000, 992
    learning = BackgroundLearning(made.algorithm, made.training)
    with learning.ahead(made.progress, None):
        for _ in range(scans):
            on_all_cores(lambda boat: None, range(1))
    assert made.progress.learned_steps == (1_000 + 8 * expected if expected else 992)
    assert len([*learning.learned()]) == expected


def test_what_is_stored_of_a_step_that_ends_an_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The observation after the step, where x has changed by the speed, not the next episode's first."""
    learner, steps = trainer(tmp_path, total_steps=4_000, stop=None), []
    monkeypatch.setattr(learner.algorithm, "store", steps.append)
    learner.run()
    for step in steps:
        change, speed = step.next_observation - step.observation, step.next_observation[:, 1]
        np.testing.assert_allclose(change[:, 0], speed, atol=1e-6)
    for step, following in pairwise(steps):
        ended = step.terminated | step.truncated
        np.testing.assert_array_equal(following.observation[~ended], step.next_observation[~ended])
        assert not following.observation[ended, 1].any()
    assert sum(step.truncated.sum() for step in steps)
    assert sum(step.terminated.sum() for step in steps)


def test_rows_past_the_checkpoint_are_dropped_when_a_killed_run_is_resumed(tmp_path: Path) -> None:
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
    with pytest.raises(CheckpointError) as caught:
        trainer(tmp_path).restore()
    assert caught.value.code == "not_found"


def test_a_checkpoint_of_another_network_is_not_resumed(tmp_path: Path) -> None:
    learner = trainer(tmp_path, total_steps=400)
    learner.run()
    other = trainer_in(learner.run_directory, Training(**{**SETTINGS, "hidden_sizes": (16,)}))
    with pytest.raises(CheckpointError):
        other.restore()


def test_a_metric_of_some_updates_has_a_column() -> None:
    """As the loss of an actor that is updated less often than its critic."""
    recorder = UpdateRecorder(stride=3)
    assert recorder.add({"loss": 1.0}) is None
    assert recorder.add({"loss": 2.0, "actor_loss": 5.0}) is None
    assert recorder.add({"loss": 6.0}) == {"loss": 3.0, "actor_loss": 5.0}


def test_the_thesis_preset_makes_one_update_a_step(tmp_path: Path) -> None:
    training = Training(preset="thesis", total_steps=100, replay_capacity=1000, hidden_sizes=(8, 8))
    learner = trainer_in(RunDirectory.create(tmp_path, "toy", 0), training)
    seen: list[int] = []
    learner.on_progress = lambda progress: seen.append(progress.updates)
    learner.run()
    assert seen == [0] * 33 + list(range(1, 68))  # recorded a step later
    assert learner.progress.updates == 68


def progress(docked: list[bool], own: list[bool], validation: tuple[int, int]) -> Progress:
    state = Progress(evaluation_docked=validation[0], evaluation_episodes=validation[1])
    for d, o in zip(docked, own, strict=True):
        state.count_episode("docked" if d else "timeout", o, window=100)
    return state


@pytest.mark.parametrize(
    ("docked", "own", "validation", "mastered"),
    [
        ([True] * 10, [True] * 10, (1, 1), True),
        ([True] * 9, [True] * 9, (1, 1), False),  # too few episodes
        ([True] * 10, [True] * 10, (4, 5), False),  # the greedy policy fails from one start
        ([True] * 10, [True] * 10, (0, 0), False),  # no validation yet
        ([True] * 9 + [False], [False] * 10, (1, 1), True),  # 9 of 10 are enough
        ([True] * 8 + [False] * 2, [False] * 10, (1, 1), False),
        ([True] * 9 + [False], [False] * 5 + [True] * 5, (1, 1), False),  # 4 of its own 5
        ([False] * 5 + [True] * 10, [True] * 15, (1, 1), True),  # long ago
    ],
)
def test_stop_rule(docked: list[bool], own: list[bool], validation: tuple[int, int], mastered: bool) -> None:
    assert progress(docked, own, validation).mastered(StopRule(docked=9, episodes=10)) is mastered


def test_episode_limit(tmp_path: Path) -> None:
    learner = trainer(tmp_path, max_episodes=5, stop=None)
    assert learner.run() == "episodes"
    assert learner.progress.episodes >= 5


def test_a_foreign_environment_without_infos(tmp_path: Path) -> None:
    """CartPole: +1 per step until the pole falls; a random policy lasts about 22 steps."""
    training = Training(
        boats=4, hidden_sizes=(64, 64), total_steps=8_000, warmup_steps=500, batch_size=64,
        steps_per_update=4, learning_rate=2e-3, final_learning_rate=5e-4, reward_scale=0.1, n_step=3,
        replay_capacity=8_000, epsilon={"decay_steps": 4_000, "end": 0.05}, evaluate_every_steps=4_000,
        stop=None,
    )  # fmt: skip
    environment = gymnasium.make_vec(
        "CartPole-v1",
        num_envs=training.boats,
        vectorization_mode="sync",
        vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
    )
    run = RunDirectory.create(tmp_path, "cartpole", 0)
    spaces = Spaces.from_env(environment)
    algorithm = training.algorithm.build(spaces, training, "cpu")
    learner = Trainer(algorithm, training, environment, run, make_card(spaces, training))
    assert learner.run() == "steps"
    rows = read_table(run.path / "episodes.csv")
    assert [row["return"] for row in rows] == [row["steps"] for row in rows]
    assert {row["outcome"] for row in rows} == {""}
    lengths = [int(row["steps"]) for row in rows]
    assert np.mean(lengths[:50]) < 35
    assert np.mean(lengths[-20:]) > 100
    assert not (run.path / "checkpoints" / "best").exists()
    policy, card = load_policy(run.path)
    assert card.env_steps == 8_000
    env = gymnasium.make("CartPole-v1")
    observation, _ = env.reset(seed=1)
    steps, over = 0, False
    while not over:
        observation, _, terminated, truncated, _ = env.step(policy.act(observation[None], {})[0])
        steps, over = steps + 1, terminated or truncated
    assert steps > 100


class WithoutInfos(ToyDocking):
    """No keys in any info, not even final observations, and no declared autoreset mode."""

    def __init__(self, num_envs: int, **options: Any) -> None:
        super().__init__(num_envs, **options)
        self.metadata = {}

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        return super().reset(**options)[0], {}

    def step(self, actions: np.ndarray) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        return *super().step(actions)[:4], {}


@pytest.mark.thorough
def test_an_environment_whose_infos_are_always_empty(tmp_path: Path) -> None:
    training, warnings = Training(**{**SETTINGS, "stop": None}), list[str]()
    environment = WithoutInfos(training.boats)
    run = RunDirectory.create(tmp_path, "toy", training.seed)
    spaces = Spaces.from_env(environment)
    algorithm = training.algorithm.build(spaces, training, "cpu")
    stored = list[Any]()
    store = algorithm.store
    algorithm.store = lambda step: (stored.append(step), store(step))  # type: ignore[method-assign]  # spy
    learner = Trainer(
        algorithm, training, environment, run, make_card(spaces, training), warn=warnings.append
    )
    assert learner.run() == "steps"
    assert any(step.truncated.any() for step in stored)
    assert all(step.terminated[step.truncated].all() for step in stored)
    assert len(warnings) == 1
    best = load_policy(run.path)[0]
    assert all(
        episode.docked
        for episode in run_episodes(ToyDocking(4, autoreset=False), best, starts_at(-1.0, -0.9))
    )


def test_an_environment_that_resets_in_the_next_step_is_refused(tmp_path: Path) -> None:
    """The default of Gymnasium: the final observation would count as the first one of the next episode."""
    training = Training(boats=2, hidden_sizes=(8,))
    environment = gymnasium.make_vec("CartPole-v1", num_envs=2, vectorization_mode="sync")
    spaces = Spaces.from_env(environment)
    algorithm = training.algorithm.build(spaces, training, "cpu")
    run = RunDirectory.create(tmp_path, "cartpole", 0)
    with pytest.raises(DockctlError, check=lambda error: error.code == "mismatch"):
        Trainer(algorithm, training, environment, run, make_card(spaces, training))


def test_an_environment_with_another_number_of_boats_is_refused(tmp_path: Path) -> None:
    training, environment = Training(boats=3, hidden_sizes=(8,)), ToyDocking(2)
    spaces = Spaces.from_env(environment)
    algorithm = training.algorithm.build(spaces, training, "cpu")
    run = RunDirectory.create(tmp_path, "toy", 0)
    with pytest.raises(DockctlError, match=r"training\.boats") as caught:
        Trainer(algorithm, training, environment, run, make_card(spaces, training))
    assert caught.value.code == "mismatch"
