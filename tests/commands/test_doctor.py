"""`dockctl doctor`: versions, folders and extras, and what is wrong with them."""

from __future__ import annotations

import json
import os
import platform
from importlib import metadata
from pathlib import Path

import pytest
import torch

from dockctl import __version__
from dockctl.experiments import doctor
from tests.commands.conftest import dockctl


def test_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    report = json.loads(dockctl("doctor", "--json", "-").out)
    versions = report["Versions"]
    assert versions["dockctl"].split()[0] == __version__
    assert versions["Python"] == platform.python_version()
    assert (versions["torch"], versions["numpy"]) == (metadata.version("torch"), metadata.version("numpy"))
    assert report["Machine"]["devices"].count("cuda") == torch.cuda.device_count()
    assert report["Machine"]["threads"].split(",")[0] == str(len(os.sched_getaffinity(0)))
    page = dockctl("doctor")
    assert page.code == 0
    assert f"| torch | {torch.__version__} |" in page.out
    assert page.out.startswith("# ")
    assert "## Problems" in page.out


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A file where a folder should be: also root cannot write there."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    outcome = dockctl("doctor")
    assert outcome.code == 0
    problems = outcome.out.partition("## Problems")[2]
    assert str(tmp_path / "file") in problems
    assert "XDG_CACHE_HOME" in problems


def test_a_missing_extra_has_its_command(monkeypatch: pytest.MonkeyPatch) -> None:
    version = doctor._version
    monkeypatch.setattr(doctor, "_version", lambda name: None if name == "onnxruntime" else version(name))
    extras = json.loads(dockctl("doctor", "--json", "-").out)["Extras"]
    assert "pip install 'dockctl[onnx]'" in extras["onnx"]
    assert "pip install" not in extras["sb3"]
