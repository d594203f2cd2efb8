"""One process at a time works on a run."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.files import exclusive_lock

HOLD = """
import sys
from pathlib import Path
from dockctl.runs.files import exclusive_lock
with exclusive_lock(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize("name", [".", "seed0.log"])
def test_a_second_process_is_refused_until_the_first_ends(tmp_path: Path, name: str) -> None:
    (tmp_path / "seed0.log").touch()
    path = tmp_path / name
    other = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert other.stdout is not None
    assert other.stdout.readline() == b"locked\n"
    with pytest.raises(DockctlError) as error, exclusive_lock(path):
        pass
    assert str(path) in str(error.value)
    assert error.value.code == "busy"
    other.communicate()
    with exclusive_lock(path):
        pass


def test_a_file_system_without_locks_is_used_without_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_locks(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    with exclusive_lock(tmp_path):
        pass


def test_a_read_only_folder_is_used_without_a_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    open_file = os.open

    def read_only(path: str, flags: int, *given: int, **named: int) -> int:
        if flags & os.O_CREAT:
            raise OSError(30, "Read-only file system", path)
        return open_file(path, flags, *given, **named)

    monkeypatch.setattr(os, "open", read_only)
    with exclusive_lock(tmp_path):
        pass


def test_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DockctlError) as error, exclusive_lock(tmp_path / "nothing"):
        pass
    assert error.value.code == "not_found"
