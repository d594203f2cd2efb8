"""One process at a time at a run."""

from __future__ import annotations

import fcntl
from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.lock import alone


def test_a_second_one_is_refused_until_the_first_is_done(tmp_path: Path) -> None:
    with (
        alone(tmp_path),
        pytest.raises(DockctlError, match="another process is at work on this"),
        alone(tmp_path),
    ):
        pass
    with alone(tmp_path):
        pass


def test_a_file_system_without_locks_is_no_hindrance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with alone(tmp_path):
        pass


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(DockctlError, match="No such file"), alone(tmp_path / "nothing"):
        pass
