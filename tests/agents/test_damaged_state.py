"""Checkpoints of a training that are damaged, edited or of another version."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import dockctl
from dockctl.agents import training_state
from dockctl.agents.checkpoint import CheckpointError, load_pair, load_policy, save_pair
from dockctl.agents.training_state import load_state
from dockctl.runs.directory import RunDirectory
from tests.agents.stops import REPLAY, TRAINING, new_run, stop_at, toy
from tests.agents.test_trainer import TABLES

pytestmark = pytest.mark.usefixtures("rows_of_several_updates")


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
