"""Provenance of a run: code, seed, libraries, machine."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dockctl
from dockctl import plugins
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


def test_packages_whose_plugins_are_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package, facts = tmp_path / "calm_terms", tmp_path / "calm_terms-1.2.dist-info"
    for folder in (package, facts):
        folder.mkdir()
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: calm-terms\nVersion: 1.2\n")
    (facts / "entry_points.txt").write_text("[dockctl.rewards]\ncalm = calm_terms.terms:calm\n")
    (package / "__init__.py").touch()
    (package / "terms.py").write_text(
        "from dockctl.rewards.terms import reward_term\n"
        "@reward_term('calm', kind='dense')\ndef calm(status): return status.nu[:, 2]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    plugins.discover.__wrapped__()
    assert "calm-terms" not in provenance.packages()  # installed, but not used
    plugins.REWARD_TERMS.get("calm")
    before = provenance.packages()["calm-terms"]
    assert (before["version"], len(before["sha256"])) == ("1.2", 64)
    (package / "terms.py").write_text("changed")
    after = provenance.packages()["calm-terms"]
    assert (after["version"], after["sha256"] != before["sha256"]) == ("1.2", True)
    for module in ("calm_terms", "calm_terms.terms"):
        monkeypatch.delitem(sys.modules, module)
