"""After a power cut at any step of a save, a training resumes and has lost at most one save interval."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.agents import training_state
from dockctl.agents.trainer import Trainer
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.training import Training
from tests.agents.test_trainer import SETTINGS, TABLES, read_table, trainer_in
from tests.runs.power import Disk

EVERY, STEPS = 400, 1_200
TRAINING = Training(
    **{
        **SETTINGS,
        "evaluate_every_steps": EVERY,
        "validation": {"every_steps": EVERY},
        "total_steps": STEPS,
        "replay_capacity": 2_000,
        "stop": None,
    }
)


def trainer(folder: Path) -> Trainer:
    return trainer_in(RunDirectory(folder), TRAINING)


def test_a_training_resumes_after_a_power_cut_at_any_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_state, "BLOCK_BYTES", 20_000)  # a third of the replay
    root = tmp_path / "run"
    root.mkdir()
    disk = Disk(root)
    watched = trainer(root)
    watched.on_progress = lambda progress: setattr(disk, "mark", progress.evaluated_at)
    with disk.watched():
        watched.run()
    disk.images = {image: saved for image, saved in disk.images.items() if saved}
    lost = []
    for number, (image, saved) in enumerate(disk.images.items()):
        again = trainer(disk.restore(image, tmp_path / f"{number}"))
        assert again.restore() == []
        reached = again.progress.env_steps
        assert reached in (saved, saved + EVERY)
        lost.append(saved + EVERY - reached)
        steps = [int(row["env_steps"]) for row in read_table(again.run_directory.path / "timing.csv")]
        assert steps[-1] == reached
    assert len(lost) > 50
    assert max(lost) == EVERY
    last = trainer(tmp_path / "0")
    last.restore()
    assert last.run() == "steps"
    for table in TABLES:
        assert (last.run_directory.path / table).read_bytes() == (root / table).read_bytes()
