"""`dockctl train --resume` after kills: of the process, and at every write at the end of a run."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from dockctl.runs.directory import RunDirectory
from tests.commands.conftest import QUICK, dockctl, only_run, quick_train

FILES = (
    "episodes.csv", "updates.csv", "evaluations.csv", "trajectories.csv",
    "checkpoints/best/policy.safetensors", "checkpoints/last/policy.safetensors",
    "checkpoints/last/learner.safetensors",
)  # fmt: skip


def contents(run: Path) -> dict[str, bytes]:
    assert json.loads((run / "provenance.json").read_text())["finished"]
    return {name: (run / name).read_bytes() for name in FILES}


@pytest.mark.thorough
@pytest.mark.slow
def test_a_run_killed_at_its_end_is_completed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """At each of the last renames: of a file and the folder of the checkpoint, trajectories, provenance."""
    replace, targets = os.replace, list[str]()

    def watched(source: Any, target: Any, **named: Any) -> None:
        """Keep what a kill before this rename would leave."""
        if Path(target).is_relative_to(tmp_path / "whole"):
            shutil.copytree(only_run(tmp_path / "whole"), tmp_path / f"{len(targets)}")
            targets.append(Path(target).name)
        replace(source, target, **named)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", watched)
        assert quick_train(tmp_path / "whole", "s1", "--steps", 120).code == 0
    whole = contents(only_run(tmp_path / "whole"))
    assert targets[-3:] == ["last", "trajectories.csv", "provenance.json"]
    for left in (1, 2, 3, 5):
        run = tmp_path / f"{len(targets) - left}"
        assert dockctl("train", "--resume", run).code == 0
        assert contents(run) == whole


KILLED = """
import os, sys
from dockctl.__main__ import main
number, replace = int(sys.argv.pop(1)), os.replace
def watched(source, target, **named):
    replace(source, target, **named)
    if os.path.basename(target) == "last-2":
        os.kill(os.getpid(), number)
os.replace = watched
main()
"""
"""Runs dockctl, and sends it a signal while it writes its third complete state."""


STEPS = 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code"),
    [
        # the signals that save are those of tests/experiments/test_interrupt.py
        pytest.param(signal.SIGTERM, 130, marks=pytest.mark.thorough),
        (signal.SIGKILL, -signal.SIGKILL),
    ],
)
def test_a_killed_process_resumes_exactly(tmp_path: Path, number: signal.Signals, code: int) -> None:
    assert quick_train(tmp_path / "whole", "s1", "--steps", STEPS).code == 0
    out = tmp_path / number.name
    settings = [word for setting in QUICK for word in ("--set", setting)]
    arguments = ["train", "s1", "--out", f"{out}", "--steps", f"{STEPS}", *settings]
    killed = [sys.executable, "-c", KILLED, f"{int(number)}", *arguments]
    assert subprocess.run(killed, stdout=subprocess.DEVNULL, timeout=600).returncode == code
    run = only_run(out)
    saved = json.loads((RunDirectory(run).checkpoint("last") / "policy.json").read_text())["env_steps"]
    assert 200 <= saved < STEPS
    assert dockctl("train", "--resume", run).code == 0
    assert contents(run) == contents(only_run(tmp_path / "whole"))


def test_resume_without_a_run_continues_the_latest_that_is_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert quick_train(Path("runs"), "s1", "--seed", 3, "--steps", 120).code == 0
    finished = only_run(Path("runs"))
    runs = [finished.with_name(f"2020010{day}-000000-seed3") for day in (2, 1)]
    for sequence, run in enumerate(runs, start=2):  # the clock was turned back between them
        shutil.copytree(finished, run)
        facts = json.loads((run / "provenance.json").read_text())
        facts |= {"finished": None, "stop_reason": "interrupted", "sequence": sequence}
        (run / "provenance.json").write_text(json.dumps(facts))
    for run in reversed(runs):
        outcome = dockctl("train", "--resume")
        assert outcome.code == 0, outcome.err
        assert f" {run}\n" in outcome.out
    outcome = dockctl("train", "--resume", "--device", "cpu")
    assert (outcome.code, outcome.error_code) == (2, "not_found")


@pytest.mark.parametrize("content", [pytest.param("", marks=pytest.mark.thorough), None])
def test_a_run_without_provenance_resumes_as_its_error_says(tmp_path: Path, content: str | None) -> None:
    assert quick_train(tmp_path, "s1", "--steps", 120).code == 0
    run = only_run(tmp_path)
    path = run / "provenance.json"
    path.unlink()
    if content is not None:
        path.write_text(content)
    refused = dockctl("train", "--resume", run, "--steps", 240)
    assert (refused.code, refused.error_code) == (2, "not_readable" if content == "" else "not_found")
    assert str(path) in refused.err
    path.write_text(refused.err[refused.err.index("{") :])
    assert dockctl("train", "--resume", run, "--steps", 240).code == 0
    assert json.loads(path.read_text())["finished"]
