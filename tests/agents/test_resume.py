"""A training that is stopped anywhere and resumed gives the bytes of the uninterrupted one."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv

import dockctl
from dockctl.agents import trainer as trainer_module
from dockctl.agents import training_state
from dockctl.agents.checkpoint import (
    CheckpointError,
    find_policy,
    load_pair,
    load_policy,
    save_pair,
    save_policy,
    saved_steps,
)
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
from dockctl.scenarios.training import Training
from dockctl.sim.world import load_checked
from tests.agents.test_trainer import SETTINGS, TABLES, make_card, trainer_in

EVERY, STEPS = 400, 1_200
TRAINING = Training(
    **{
        **SETTINGS,
        "total_steps": STEPS,
        "evaluate_every_steps": EVERY,
        "validation": {"every_steps": EVERY},
        "replay_capacity": 700,  # overwrites the oldest after 712 steps
        "warmup_steps": 100,
        "steps_per_update": 4,
        "ensemble": {"networks": 3, "every_steps": 200},
        "final_learning_rate": 1e-4,
        "epsilon": {"decay_steps": 900},
        "stop": None,
    }
)
STOPS = (8, 104, 400, 744, 1_192, 1_200)
"""Before and after the first update, at a save, with a full replay, before the last step and after it."""


REPLAY = "algorithm/replay.records"


class Killed(BaseException):
    """Ends a training without a save, like SIGKILL."""


def toy(run: RunDirectory, **options: Any) -> Trainer:
    return trainer_in(run, TRAINING, **options)


def stop_at(steps: int, run: RunDirectory, make: Any = toy, *, kill: bool = False) -> None:
    """Start or resume a training, and stop it after `steps`."""

    def on_progress(progress: Any) -> None:
        if kill and progress.env_steps >= steps:
            raise Killed

    trainer = make(run, interrupted=lambda: not kill and trainer.progress.env_steps >= steps)
    trainer.on_progress = on_progress
    if run.checkpoints("last"):
        assert trainer.restore() == []
    if kill:
        with pytest.raises(Killed):
            trainer.run()
    else:
        assert trainer.run() == "interrupted"


def finish(run: RunDirectory, make: Any = toy) -> dict[str, bytes]:
    """Start or resume a training, train to the end, and return the contents of its tables and checkpoints."""
    trainer = make(run)
    if run.checkpoints("last"):
        assert trainer.restore() == []
    assert trainer.run() == "steps"
    names = ("best/policy", "last/policy", "last/learner")
    files = (*TABLES, *(f"checkpoints/{name}.safetensors" for name in names))
    return {file: (run.path / file).read_bytes() for file in files}


def new_run(folder: Path) -> RunDirectory:
    return RunDirectory.create(folder, "test", 0)


@pytest.fixture(scope="module", autouse=True)
def rows_of_several_updates() -> Iterator[None]:
    """Most stops are between the updates of one row of updates.csv, as in longer trainings."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer_module, "UPDATE_ROWS", TRAINING.updates_due(TRAINING.total_steps) // 7)
        yield


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return finish(new_run(tmp_path_factory.mktemp("whole")))


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


def damage(file: Path, how: str) -> None:
    content = file.read_bytes()
    middle = len(content) // 2
    if how == "gone":
        file.unlink()
    elif how == "torn":
        file.write_bytes(content[:middle])
    else:
        flipped = b"8" if content[middle : middle + 1] != b"8" else b"9"
        file.write_bytes(content[:middle] + flipped + content[middle + 1 :])


def test_a_damaged_checkpoint_is_replaced_by_the_previous_one(
    tmp_path: Path, uninterrupted: dict[str, bytes]
) -> None:
    run = new_run(tmp_path / "run")
    for steps in (304, 640):
        stop_at(steps, run)
    for name in ("policy.json", "policy.safetensors", "learner.json", "learner.safetensors"):
        for how in ("gone", "torn", "changed"):
            copy = RunDirectory(tmp_path / f"{name}-{how}")
            shutil.copytree(run.path, copy.path)
            damage(copy.checkpoint("last") / name, how)
            trainer = toy(copy)
            (warning,) = trainer.restore()
            assert str(copy.path / "checkpoints" / "last" / name) in warning
            assert str(copy.path / "checkpoints" / "last-1") in warning
            assert trainer.progress.env_steps == 400
    trainer.run()
    for table in TABLES:
        assert (copy.path / table).read_bytes() == uninterrupted[table]


@pytest.mark.parametrize("content", ["[]", "null", '{"blocks": [{}]}'])
def test_facts_of_another_type_are_damaged(
    tmp_path: Path, content: str, uninterrupted: dict[str, bytes]
) -> None:
    run = new_run(tmp_path)
    for steps in (304, 640):
        stop_at(steps, run)
    (run.checkpoint("last") / "learner.json").write_text(content)
    trainer = toy(run)
    (warning,) = trainer.restore()
    assert str(run.checkpoint("last") / "learner.json") in warning
    trainer.run()
    for table in TABLES:
        assert (run.path / table).read_bytes() == uninterrupted[table]


def test_files_of_different_saves_are_no_checkpoint(tmp_path: Path, uninterrupted: dict[str, bytes]) -> None:
    run = new_run(tmp_path / "run")
    for steps in (304, 640):
        stop_at(steps, run)
    _, previous = run.checkpoints("last")[:2]
    for pair in ("policy", "learner"):
        copy = RunDirectory(tmp_path / pair)
        shutil.copytree(run.path, copy.path)
        for file in previous.glob(f"{pair}.*"):
            shutil.copy(file, copy.path / "checkpoints" / "last")
        trainer = toy(copy)
        (warning,) = trainer.restore()
        assert f"{copy.path / 'checkpoints' / 'last'}: " in warning
        assert str(copy.path / "checkpoints" / "last-1") in warning
    trainer.run()
    for table in TABLES:
        assert (copy.path / table).read_bytes() == uninterrupted[table]


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("progress", "env_steps"), -8),
        (("algorithm", "updates"), "many"),
        (("algorithm", "updates"), 1e300),
        (("algorithm", "updates"), -(10**12)),
        (("algorithm", "slowdown"), "slow"),
        (("algorithm", "slowdown"), 0),
        (("algorithm", "exploration", "state", "state"), -1),
        (("monitor", "reward"), None),
        (("tables", "episodes.csv"), "x"),
        (("tables", "episodes.csv", "bytes"), 1.5),
        (("tables", "updates.csv", "lines"), None),
        (("blocks",), "many"),
        (("blocks",), {"algorithm/replay": ["../policy"]}),
        (("blocks",), {"algorithm/replay": []}),
        (("blocks",), {"algorithm/replay": ""}),
    ],
)
def test_numbers_that_no_save_has_written_are_refused(
    tmp_path: Path, path: tuple[str, ...], value: object
) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    group = facts
    for key in path[:-1]:
        group = group[key]
    group[path[-1]] = value
    save_pair(folder, "learner", tensors, facts)
    with pytest.raises(CheckpointError) as caught:
        toy(run).restore()
    assert str(folder) in caught.value.message


@pytest.mark.parametrize("shape", [(), (2, 8), (2, 8, 0), (2, 7, 2), (1, 2, 8, 2)])
def test_observations_of_another_shape_are_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    assert tensors["monitor/probes"].shape[1:] == (TRAINING.boats, 2)
    save_pair(folder, "learner", {**tensors, "monitor/probes": np.zeros(shape)}, facts)
    with pytest.raises(CheckpointError) as caught:
        toy(run).restore()
    assert str(folder) in caught.value.message


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


@pytest.mark.thorough
def test_a_block_that_is_listed_again_and_again_does_not_fill_the_memory(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    name = "0" * 64
    file = run.path / "checkpoints" / "blocks" / f"{name}.safetensors"
    file.parent.mkdir(exist_ok=True)
    with file.open("wb") as content:
        content.truncate(10**7)  # a sparse file
    save_pair(folder, "learner", tensors, {**facts, "blocks": {"algorithm/replay": [name] * 200_000}})
    with pytest.raises(CheckpointError) as caught:
        load_state(run)
    assert caught.value.code == "out_of_range"
    assert str(folder) in caught.value.message


@pytest.mark.parametrize("progress", [{}, {"env_steps": "many"}, {"env_steps": None}, [8], "8", None])
def test_a_state_without_its_steps_is_refused(tmp_path: Path, progress: object) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    save_pair(folder, "learner", tensors, {**facts, "progress": progress})
    with pytest.raises(CheckpointError) as caught:
        _ = load_state(run).env_steps
    assert str(folder) in caught.value.message


@pytest.mark.parametrize("missing", ["algorithm/online", "updates"])
@pytest.mark.parametrize("version", ["0.0.1", dockctl.__version__])
def test_an_incomplete_state_is_of_another_version_or_edited_and_its_policy_loads(
    tmp_path: Path, missing: str, version: str
) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    folder = run.checkpoint("last")
    tensors, facts = load_pair(folder / "learner.json")
    kept = {name: array for name, array in tensors.items() if not name.startswith(missing)}
    facts = {name: fact for name, fact in facts.items() if name != missing} | {"dockctl": version}
    save_pair(folder, "learner", kept, facts)
    with pytest.raises(CheckpointError) as caught:
        toy(run).restore()
    assert str(folder) in caught.value.message
    assert version in caught.value.message
    _, card = load_policy(run.path)
    assert card.env_steps == 304


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
    tmp_path: Path, uninterrupted: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[int] = []

    def sample(self: Replay, size: int) -> Batch:
        drawn.append(size)
        return original(self, size)

    original = Replay.sample
    monkeypatch.setattr(Replay, "sample", sample)
    monkeypatch.setattr(algorithm, "DRAWN_BYTES", 1)
    assert finish(new_run(tmp_path)) == uninterrupted
    assert max(drawn) == TRAINING.batch_size < TRAINING.boats // TRAINING.steps_per_update * max(drawn)


def test_a_best_policy_of_steps_that_are_trained_again_is_dropped(tmp_path: Path) -> None:
    run = new_run(tmp_path)
    stop_at(304, run)
    trainer = toy(run)
    for steps in (200, 9_000):
        with run.new_checkpoint("best") as folder:
            card = trainer.card.model_copy(update={"env_steps": steps})
            save_policy(folder, trainer.algorithm.policy_tensors(), card)
    trainer.restore()
    assert [saved_steps(folder) for folder in run.checkpoints("best")] == [200]
    assert saved_steps(find_policy(run.path).parent) == 200


def two_saves(folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[RunDirectory, set[str], set[str]]:
    """Return a stopped training, and the blocks of the replay in its newest save and the one before."""
    monkeypatch.setattr(training_state, "BLOCK_BYTES", 3_200)
    run = new_run(folder)
    for steps in (304, 640):
        stop_at(steps, run)
    of_last, of_previous = (
        {*json.loads((saved / "learner.json").read_text())["blocks"][REPLAY]}
        for saved in run.checkpoints("last")[:2]
    )
    return run, of_last, of_previous


@pytest.mark.parametrize("how", ["gone", "torn", "changed"])
def test_a_damaged_block_is_detected(tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    run, of_last, of_previous = two_saves(tmp_path, monkeypatch)
    folder = run.path / "checkpoints" / "blocks"
    damage(folder / f"{min(of_last - of_previous)}.safetensors", how)
    assert load_state(run).folder == run.path / "checkpoints" / "last-1"
    shared = folder / f"{min(of_last & of_previous)}.safetensors"
    damage(shared, how)
    with pytest.raises(CheckpointError) as caught:
        load_state(run)
    assert caught.value.message.count(str(shared)) == 1


@pytest.mark.parametrize("how", ["gone", "torn", "changed"])
def test_a_damaged_block_is_written_again_by_the_next_save_that_needs_it(
    tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else the training would go on to save checkpoints that nothing can be resumed from."""
    run, of_last, of_previous = two_saves(tmp_path, monkeypatch)
    damage(run.path / "checkpoints" / "blocks" / f"{min(of_last - of_previous)}.safetensors", how)
    trainer = toy(run, interrupted=lambda: trainer.progress.env_steps >= 640)
    assert len(trainer.restore()) == 1
    assert trainer.run() == "interrupted"
    state = load_state(run)
    assert (state.damaged, state.env_steps) == ((), 640)


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
