"""Training as a Python API."""

from __future__ import annotations

import errno
import gc
import io
import json
import os
import re
from pathlib import Path

import pytest
from rich.console import Console

from dockctl.agents.algorithms import Dqn
from dockctl.agents.dqn.replay import Replay
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.experiments import resume, train
from dockctl.runs.directory import SHIPPED
from dockctl.scenarios.loader import dump, load
from tests.commands.conftest import QUICK


def test_a_run_is_trained_and_extended(tmp_path: Path) -> None:
    console = Console(file=io.StringIO())
    run = train("s1", seed=2, steps=60, overrides=QUICK, out=str(tmp_path), console=console)
    assert (run.reason, run.progress.env_steps) == ("steps", 60)
    assert json.loads((run.path / "provenance.json").read_text())["seed"] == 2
    extended = resume(str(run.path), steps=80, console=console)
    assert (extended.path, extended.progress.env_steps) == (run.path, 80)
    with pytest.raises(DockctlError):
        resume(run.path, console=console)


@pytest.mark.parametrize("name", ["scenario.yaml", "scene.json", "provenance.json"])
def test_a_run_folder_that_cannot_be_completed_is_removed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bytes = Path.write_bytes

    def on_a_full_disk(self: Path, content: bytes) -> int:
        if name in self.name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write_bytes(self, content)

    (tmp_path / "mine.txt").touch()
    monkeypatch.setattr(Path, "write_bytes", on_a_full_disk)
    with pytest.raises(DockctlError) as caught:
        train("s1", steps=60, overrides=QUICK, out=tmp_path, console=Console(quiet=True))
    assert caught.value.code == "not_writable"
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_a_finished_training_frees_its_memory_without_the_garbage_collector(tmp_path: Path) -> None:
    """Reference cycles would keep replays, of which the collector knows only that they are few objects."""
    console = Console(file=io.StringIO())
    gc.collect()
    gc.disable()
    try:
        run = train("s1", seed=2, steps=60, overrides=QUICK, out=tmp_path, console=console)
        resume(run.path, steps=80, console=console)
        kept = [held for held in gc.get_objects() if isinstance(held, Replay | DockingVectorEnv)]
    finally:
        gc.enable()
    assert not kept


@pytest.mark.parametrize("name", ["s1", "marina"])
def test_scenario_files_without_an_algorithm_mean_dqn(name: str, tmp_path: Path) -> None:
    text = (SHIPPED / name / "scenario.yaml").read_text()
    (tmp_path / "earlier.yaml").write_text(re.sub(r"  algorithm:\n    kind: dqn\n", "", text))
    scenario = load(tmp_path / "earlier.yaml").scenario
    assert scenario.training.algorithm == Dqn()
    (tmp_path / "again.yaml").write_text(dump(scenario))
    assert load(tmp_path / "again.yaml").scenario.training == scenario.training
