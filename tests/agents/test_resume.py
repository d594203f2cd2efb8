"""A training that is stopped anywhere and resumed gives the bytes of the uninterrupted one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv

from dockctl import compute
from dockctl.agents import training_state
from dockctl.agents.background_learning import BackgroundLearning
from dockctl.agents.checkpoint import find_policy, load_pair, save_pair, save_policy, saved_steps
from dockctl.agents.dqn import algorithm
from dockctl.agents.dqn.replay import Batch, Replay
from dockctl.agents.interface import Spaces
from dockctl.agents.trainer import Trainer
from dockctl.agents.training_state import load_state
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.rollout import Rollout, evaluation_rows
from dockctl.evaluation.starts import validation_starts
from dockctl.runs.directory import RunDirectory
from dockctl.runs.tables import Value
from dockctl.sim.checks import load_checked
from tests.agents.stops import REPLAY, TRAINING, finish, new_run, stop_at, toy
from tests.agents.test_trainer import make_card

pytestmark = pytest.mark.usefixtures("rows_of_several_updates")


STOPS = (8, 104, 400, 744, 1_192, 1_200)
"""Before and after the first update, at a save, with a full replay, before the last step and after it."""


@pytest.mark.parametrize("kill", [False, True])
def test_a_stopped_training_resumes_exactly(
    tmp_path: Path, uninterrupted: dict[str, bytes], kill: bool
) -> None:
    for steps in STOPS[kill * 2 :]:  # without a save there is nothing to resume
        run = new_run(tmp_path)
        stop_at(steps, run, kill=kill)
        resumed = finish(run)
        assert [name for name in resumed if resumed[name] != uninterrupted[name]] == [], steps


def test_a_training_stopped_many_times_resumes_exactly(
    tmp_path: Path, uninterrupted: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In small blocks, of which three checkpoints of different steps keep their own."""
    monkeypatch.setattr(training_state, "BLOCK_BYTES", 2_000)
    run = new_run(tmp_path)
    for number, steps in enumerate((48, 56, 296, 512, 512, 904, 1_104)):
        stop_at(steps, run, kill=number % 3 == 2)
    resumed = finish(run)
    last = "checkpoints/last/learner.safetensors"
    assert len(resumed.pop(last)) < len(uninterrupted[last])
    assert resumed == {name: uninterrupted[name] for name in resumed}


def test_a_save_writes_only_new_transitions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training_state, "BLOCK_BYTES", 3_200)  # 100 transitions of 32 bytes
    run, saves, written = new_run(tmp_path), [], {}
    for steps in (304, 312, 704, 760, 1_200):
        stop_at(steps, run)
        state = load_state(run)
        saves.append((int(state.tensors["algorithm/replay.added"][0]), state.facts["blocks"][REPLAY]))
        blocks = {file.stem: file.stat().st_ino for file in run.path.glob("checkpoints/blocks/*")}
        assert blocks == {**blocks, **{name: file for name, file in written.items() if name in blocks}}
        written = blocks
    for (before, old), (after, new) in pairwise(saves):
        changed = {number % 700 // 100 for number in range(before, after)}
        assert len(changed) < 7
        assert {i for i, name in enumerate(new) if name not in old} == changed
    files = {file.stem for file in run.path.glob("checkpoints/blocks/*")}
    listed = [json.loads((f / "learner.json").read_text())["blocks"] for f in run.checkpoints("last")]
    assert files == {name for blocks in listed for names in blocks.values() for name in names}
    assert not {*saves[0][1]} <= files


def test_sums_of_rewards_continue_whatever_their_type(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    sums = np.zeros((1, TRAINING.boats), np.int8)
    save_pair(folder, "learner", {**tensors, "episodes/terms": sums}, {**facts, "terms": ["distance"]})
    trainer = toy(run)
    trainer.restore()
    rewards = np.full(TRAINING.boats, -0.25)
    done = np.ones(TRAINING.boats, bool)
    rows = trainer.episode_recorder.add(rewards, {"reward_terms": {"distance": rewards}}, done)
    assert {row["reward_distance"] for row in rows} == {-0.25}


def test_the_state_of_an_optimizer_of_torch_before_its_first_step(
    tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    """It has no moments, as of a training on a GPU that is continued on the processor."""
    run = new_run(tmp_path)
    stop_at(8, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    kept = {name: array for name, array in tensors.items() if ".optimizer" not in name.replace("/", ".")}
    assert len(kept) < len(tensors)
    save_pair(folder, "learner", kept, facts)
    assert finish(run) == uninterrupted


def test_updates_in_parts_that_fit_into_memory_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Apart from those made ahead, which need the parts of several steps at once."""
    monkeypatch.setattr(BackgroundLearning, "ahead", lambda *arguments: nullcontext())
    whole, drawn = finish(new_run(tmp_path / "whole")), list[int]()

    def sample(self: Replay, size: int) -> Batch:
        drawn.append(size)
        return original(self, size)

    original = Replay.sample
    monkeypatch.setattr(Replay, "sample", sample)
    monkeypatch.setattr(algorithm, "DRAWN_BYTES", 1)
    assert finish(new_run(tmp_path / "parts")) == whole
    assert max(drawn) == TRAINING.batch_size < TRAINING.boats // TRAINING.steps_per_update * max(drawn)


def test_a_best_policy_of_steps_that_are_trained_again_is_dropped(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    made = toy(run)
    for steps in (200, 9_000):
        with run.new_checkpoint("best") as folder:
            card = made.card.model_copy(update={"env_steps": steps})
            save_policy(folder, made.algorithm.policy_tensors(), card)
    made.restore()
    assert [saved_steps(folder) for folder in run.checkpoints("best")] == [200]
    assert saved_steps(find_policy(run.path).parent) == 200


def cart_poles(run: RunDirectory, **options: Any) -> Trainer:
    environment: VectorEnv[Any, Any, Any] = gymnasium.make_vec(
        "CartPole-v1", TRAINING.boats, "sync", vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP}
    )
    spaces = Spaces.from_env(environment)
    learner = TRAINING.algorithm.build(spaces, TRAINING, "cpu")
    return Trainer(learner, TRAINING, environment, run, make_card(spaces, TRAINING), **options)


def test_an_environment_that_cannot_be_saved_starts_new_episodes(tmp_path: Path) -> None:
    results = []
    for _ in range(2):
        run = new_run(tmp_path)
        stop_at(600, run, cart_poles)
        second = cart_poles(run)
        assert len(second.restore()) == 1
        assert second.run() == "steps"
        results.append([(run.path / table).read_bytes() for table in ("episodes.csv", "updates.csv")])
    assert results[0] == results[1]


def docking(scenario: str, overrides: Sequence[str]) -> Any:
    loaded = load_checked(scenario, overrides=overrides)
    rollout = Rollout(loaded)
    training, starts = loaded.scenario.training, validation_starts(loaded.scenario, rollout.worlds)

    def validate(policy: Any) -> list[dict[str, Value]]:
        return evaluation_rows(rollout.validate(policy, starts))

    def make(run: RunDirectory, **options: Any) -> Trainer:
        environment = DockingVectorEnv(loaded, training.boats, exploring=True, worlds=rollout.worlds)
        spaces = Spaces.from_env(environment)
        learner = training.algorithm.build(spaces, training, "cpu")
        return Trainer(learner, training, environment, run, make_card(spaces, training), validate, **options)

    return make


OVERRIDES = (
    "training.boats=4", "training.warmup_steps=40", "training.batch_size=16", "training.steps_per_update=4",
    "training.replay_capacity=300", "training.evaluate_every_steps=200", "training.hidden_sizes=[16, 8]",
    "training.exploring_starts.steps=30", "task.max_steps=40", "training.target_update_interval=20",
    "training.epsilon.decay_steps=400", "training.stop=null", "training.total_steps=600",
    "training.validation={starts: 2, every_steps: 200}",
)  # fmt: skip


CURRENT = "conditions={current: {speed_mps: [0.0, 0.2], direction_deg: [0, 360]}}"


def test_an_error_of_the_environments_state_names_the_checkpoint(tmp_path: Path) -> None:
    make, run = docking("s1", (*OVERRIDES, "sensors.lidar={kind: planar}")), new_run(tmp_path)
    stop_at(40, run, make)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    tensors["environment/simulator.eta"] = tensors["environment/simulator.eta"][:2]
    save_pair(folder, "learner", tensors, facts)
    with pytest.raises(DockctlError, check=lambda error: error.code == "mismatch") as caught:
        make(run).restore()
    assert str(folder) in caught.value.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "overrides"),
    [
        pytest.param("s2", (*OVERRIDES, "sensors.lidar={kind: planar}", CURRENT), marks=pytest.mark.thorough),
        ("s3", (*OVERRIDES, "training.retried_starts={fraction: 0.6}")),
    ],
)
def test_docking_boats_resume_in_the_middle_of_their_episodes(
    tmp_path: Path, scenario: str, overrides: tuple[str, ...]
) -> None:
    make = docking(scenario, overrides)
    whole = finish(new_run(tmp_path), make)
    run = new_run(tmp_path)
    for steps, kill in ((52, False), (232, True), (300, False), (424, True), (596, False)):
        stop_at(steps, run, make, kill=kill)
    resumed = finish(run, make)
    assert [name for name in resumed if resumed[name] != whole[name]] == []


@pytest.mark.slow
def test_the_number_of_cores_does_not_change_a_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even if the updates of a step take longer than the step."""
    slow = ("training.hidden_sizes=[256, 256]", "training.batch_size=512", "training.steps_per_update=1")
    make, results = docking("s3", (*OVERRIDES, *slow, "training.total_steps=400")), []
    for cores in (2, 5):
        monkeypatch.setattr(compute, "usable_cores", lambda cores=cores: cores)
        monkeypatch.setattr(compute, "_WORKERS", [])
        results.append(finish(new_run(tmp_path / str(cores)), make))
        compute.workers().shutdown()
    assert [name for name in results[0] if results[0][name] != results[1][name]] == []
