"""Logs for TensorBoard and Weights & Biases have the numbers of the tables, also after a resume."""

from __future__ import annotations

import csv
import json
import signal
import struct
import time
from collections.abc import Iterator, Sequence
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from dockctl.agents.progress import Progress
from dockctl.experiments import logs
from dockctl.experiments.live import TrainingDisplay
from dockctl.runs.directory import RunDirectory
from dockctl.runs.tables import EPISODES, EVALUATIONS, TIMING, UPDATES
from tests.commands.conftest import dockctl, only_run, quick_train

COLUMNS = {"episodes": EPISODES, "updates": UPDATES, "evaluations": EVALUATIONS, "timing": TIMING}
Points = dict[str, list[tuple[int, float]]]


def table(run: Path, name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((run / f"{name}.csv").read_text().splitlines()))


def expected(run: Path) -> Points:
    """Compute the points from the tables."""
    found: Points = {}
    for name in ("episodes", "updates"):
        for row in table(run, name):
            numbers = {key: value for key, value in row.items() if key not in logs.LABELS and value}
            if "outcome" in row:
                numbers["docked"] = str(int(row["outcome"] == "docked"))
            for key, value in numbers.items():
                if key not in ("start_kind", "outcome", "collided_with"):
                    found.setdefault(f"{name}/{key}", []).append((int(row["env_steps"]), float(value)))
    rows = table(run, "evaluations")
    for kind, step in dict.fromkeys((row["start_kind"], int(row["env_steps"])) for row in rows):
        group = [row for row in rows if (row["start_kind"], int(row["env_steps"])) == (kind, step)]
        docked = float(np.mean([row["outcome"] == "docked" for row in group]))
        found.setdefault(f"evaluations/{kind}/docked", []).append((step, docked))
        for key in ("return", "steps", "distance_m", "best"):
            mean = float(np.mean([float(row[key]) for row in group]))
            found.setdefault(f"evaluations/{kind}/{key}", []).append((step, mean))
    return found


def tensorboard(run: Path) -> Points:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(run / "tensorboard"), size_guidance={"scalars": 0})
    events.Reload()
    return {
        tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in events.Tags()["scalars"]
    }


def assert_same(found: Points, run: Path) -> None:
    wanted = expected(run)
    assert set(wanted) <= set(found)
    others = set(found) - set(wanted)
    assert all(name.startswith("evaluations/") for name in others), others
    for name, points in wanted.items():
        assert [step for step, _ in found[name]] == [step for step, _ in points], name
        np.testing.assert_allclose(
            [value for _, value in found[name]], [value for _, value in points], rtol=1e-5, atol=1e-6
        )


def write_tables(run: RunDirectory, names: Sequence[str], *, restore: bool = False) -> None:
    """Write tables as a training does, up to a save at step 200, and go on; then back to the save, and on."""
    rng = np.random.default_rng(len(list(run.path.iterdir())))
    with logs.logged(run, names):
        tables = [run.table(f"{name}.csv", columns) for name, columns in COLUMNS.items()]
        episodes, updates, evaluations, _ = tables
        saved_at = run.path / "saved.json"
        first = 0
        if restore:
            first = 200
            for table, saved in zip(tables, json.loads(saved_at.read_text()), strict=True):
                table.restore(saved, first)
        for step in range(first + 10, first + 310, 10):
            if step == 210 and not restore:
                saved_at.write_text(json.dumps([table.save() for table in tables]))
            if step == 210:  # an update of step 200, made while the boats took the next step
                updates.append([{"update": 201, "env_steps": 200, "loss": rng.random()}])
            row = {"episode": step, "env_steps": step, "start_kind": "pose", "epsilon": None}
            outcome = str(rng.choice(["docked", "collision"]))
            episodes.append([{**row, "outcome": outcome, "return": rng.normal() * 1e4, "reward_final": 1.0}])
            updates.append([{"update": step, "env_steps": step, "loss": rng.random()}])
            if step % 100 == 0:
                evaluations.append(
                    {"env_steps": step, "start_kind": kind, "pose": i, "outcome": outcome, "best": i == 0}
                    | {"return": rng.normal(), "steps": 3, "distance_m": rng.random()}
                    for kind in ("pose", "validation")
                    for i in range(4)
                )


@pytest.mark.parametrize("parts", [1, 2])
def test_tensorboard_has_the_numbers_of_the_tables(parts: int, tmp_path: Path) -> None:
    """Also of a training that goes back to a save and repeats its steps with other results."""
    pytest.importorskip("tensorboard")
    run = RunDirectory(tmp_path)
    for part in range(parts):
        write_tables(run, ["tensorboard"], restore=bool(part))
    assert len(list((tmp_path / "tensorboard").iterdir())) == parts
    assert_same(tensorboard(tmp_path), tmp_path)


@pytest.mark.slow
def test_the_log_of_a_training_that_is_interrupted_and_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A resumed training continues its log, also from an earlier save."""
    pytest.importorskip("tensorboard")
    show = TrainingDisplay.__call__

    def press_ctrl_c(self: TrainingDisplay, progress: Progress) -> None:
        show(self, progress)
        if progress.env_steps == 150:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(TrainingDisplay, "__call__", press_ctrl_c)
    assert quick_train(tmp_path, "s1", "--steps", 200, "--log", "tensorboard").code == 130
    run = only_run(tmp_path)
    assert_same(tensorboard(run), run)
    last = run / "checkpoints" / "last"
    for file in last.iterdir():  # the save at step 150 is lost: steps after 100 are trained again
        file.write_bytes(b"")
    resumed = dockctl("train", "--resume", run)
    assert resumed.code == 130 or resumed.code == 0
    if resumed.code == 130:
        assert dockctl("train", "--resume", run).code == 0
    assert len(list((run / "tensorboard").iterdir())) >= 2
    assert_same(tensorboard(run), run)
    assert json.loads((run / "provenance.json").read_text())["log"] == ["tensorboard"]


@pytest.mark.thorough
@pytest.mark.slow
def test_the_log_changes_no_table(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    for folder, words in (("with", ("--log", "tensorboard")), ("without", ())):
        assert quick_train(tmp_path / folder, "s1", "--steps", 100, *words).code == 0
    one, other = only_run(tmp_path / "with"), only_run(tmp_path / "without")
    for name in ("episodes.csv", "updates.csv", "evaluations.csv"):
        assert (one / name).read_bytes() == (other / name).read_bytes()


def wandb_records(file: Path) -> Iterator[bytes]:
    """Yield the whole records in a log of wandb: LevelDB's format, after a header of 7 bytes."""
    content, at, parts = file.read_bytes(), 7, b""
    assert content[:4] in (b":W&B", b"")
    while at + 7 <= len(content):
        if (left := 32_768 - at % 32_768) < 7:
            at += left
            continue
        length, kind = struct.unpack("<HB", content[at + 4 : at + 7])
        if at + 7 + length > len(content):  # still being written
            return
        parts += content[at + 7 : at + 7 + length]
        at += 7 + length
        if kind in (1, 4):  # a whole record, or the last part of one
            yield parts
            parts = b""


@pytest.mark.slow
@pytest.mark.thorough
def test_wandb_has_the_numbers_of_the_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    from wandb.proto import wandb_internal_pb2

    monkeypatch.setenv("WANDB_CONFIG_DIR", str(tmp_path / "config"))
    assert (
        quick_train(
            tmp_path / "runs", "s1", "--steps", 200, "--log", "wandb", "--tag", "a", "--name", "b"
        ).code
        == 0
    )
    run = only_run(tmp_path / "runs")
    (file,) = (run / "wandb").glob("offline-run-*/*.wandb")
    deadline = time.monotonic() + 60  # the service process of wandb may still be writing
    while not (records := list(map(wandb_internal_pb2.Record.FromString, wandb_records(file)))) or not (
        records[-1].HasField("exit")
    ):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    (started,) = (record.run for record in records if record.HasField("run"))
    assert (started.display_name, [*started.tags]) == ("b", ["a"])
    found: Points = {}
    for record in records:
        items = {
            "/".join(item.nested_key) or item.key: json.loads(item.value_json) for item in record.history.item
        }
        for name, value in items.items():
            if "/" in name:
                found.setdefault(name, []).append((int(items["env_steps"]), float(value)))
    assert_same(found, run)


def test_a_log_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    unknown = quick_train(tmp_path, "s1", "--log", "tensorbord")
    assert unknown.error
    assert (unknown.code, unknown.error.code, unknown.error.suggestion) == (2, "unknown_name", "tensorboard")

    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(logs.metadata, "version", missing)
    outcome = quick_train(tmp_path, "s1", "--log", "wandb")
    assert (outcome.code, outcome.error_code) == (2, "unavailable")
    assert "pip install 'dockctl[wandb]'" in outcome.err
    assert [*tmp_path.iterdir()] == []
