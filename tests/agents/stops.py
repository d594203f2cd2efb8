"""Trainings that are stopped or killed, and resumed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from dockctl.agents.trainer import Trainer
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.training import Training
from tests.agents.test_trainer import SETTINGS, TABLES, trainer_in

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
        "ensemble": {"networks": 3, "every_steps": 200, "restarts": 1},
        "final_learning_rate": 1e-4,
        "epsilon": {"decay_steps": 900},
        "stop": None,
    }
)


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
