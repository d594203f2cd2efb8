"""Atomic writes and locks of files and folders."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.files import exclusive_lock, intact, new_folder, write_atomically
from dockctl.runs.tables import Table

LOCK_SCRIPT = """
import sys
from pathlib import Path
from dockctl.runs.files import exclusive_lock
with exclusive_lock(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def full(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_failed_write_leaves_the_old_file_intact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_atomically(tmp_path / "a.txt", b"old")
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(DockctlError, match=r"a\.txt") as caught:
        write_atomically(path, b"new")
    assert caught.value.code == "not_writable"
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.txt"]


def test_a_new_folder_replaces_the_old_one(tmp_path: Path) -> None:
    for generation in ("one", "two"):
        with new_folder(tmp_path / "best") as new:
            (new / generation).touch()
        assert names(tmp_path) == ["best"]
        assert names(tmp_path / "best") == [generation]


def test_the_old_folder_stays_when_the_new_one_fails(tmp_path: Path) -> None:
    with new_folder(tmp_path / "best") as new:
        (new / "one").touch()

    def fail() -> None:
        with new_folder(tmp_path / "best") as new:
            (new / "half").touch()
            full()

    with pytest.raises(DockctlError, match="best") as caught:
        fail()
    assert caught.value.code == "not_writable"
    assert names(tmp_path / "best") == ["one"]


def test_a_table_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(DockctlError, match=r"t\.csv") as caught:
        Table(tmp_path / "t.csv", ["a"]).append([{"a": 1}])
    assert caught.value.code == "not_writable"


def test_the_previous_folder_is_read_and_restored_if_the_replacement_was_killed(tmp_path: Path) -> None:
    best = tmp_path / "best"
    with new_folder(best) as new:
        (new / "one").touch()
    assert intact(best) == best
    best.rename(tmp_path / ".best.old")
    assert names(intact(best)) == ["one"]

    def fail() -> None:
        with new_folder(best):
            full()

    with pytest.raises(DockctlError):
        fail()
    assert (names(best), intact(best)) == (["one"], best)


@pytest.mark.parametrize("name", [".", "seed0.log"])
def test_a_second_process_is_rejected_until_the_first_ends(tmp_path: Path, name: str) -> None:
    (tmp_path / "seed0.log").touch()
    path = tmp_path / name
    other = subprocess.Popen(
        [sys.executable, "-c", LOCK_SCRIPT, str(path)],
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


def test_locking_a_missing_folder_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DockctlError) as error, exclusive_lock(tmp_path / "nothing"):
        pass
    assert error.value.code == "not_found"
