"""Provenance of a run: code, seed, libraries, machine."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import numpy as np
import pytest

import dockctl
from dockctl.runs import provenance


def test_all_facts_are_present_and_plain_json() -> None:
    facts = provenance.collect(3, ["dockctl", "train"])
    assert json.loads(json.dumps(facts)) == facts
    assert facts["seed"] == 3
    assert facts["dockctl"] == dockctl.__version__
    assert facts["libraries"]["numpy"] == np.__version__
    assert facts["command"] == ["dockctl", "train"]
    assert facts["hardware"]["cores"] >= 1
    assert facts["finished"] is None
    assert facts["started"].endswith("+00:00")


def test_the_commit_of_a_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dockctl, "__file__", str(tmp_path / "dockctl" / "__init__.py"))
    assert provenance.git_commit() is None
    git = ["git", "-C", str(tmp_path), "-c", "user.name=n", "-c", "user.email=e@x"]
    (tmp_path / "file").write_text("1")
    for command in (["init", "-q"], ["add", "file"], ["commit", "-qm", "m"]):
        subprocess.run([*git, *command], check=True)
    commit = provenance.git_commit()
    assert commit is not None
    assert len(commit) == 40
    (tmp_path / "file").write_text("2")
    assert provenance.git_commit() == commit + "+"
