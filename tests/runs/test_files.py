"""Atomic writes of files and folders."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.files import intact, new_folder, write_atomically
from dockctl.runs.tables import Table


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


def full(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_failed_write_leaves_the_old_file_intact(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_atomically(tmp_path / "a.txt", b"old")
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(DockctlError, match=r"a\.txt"):
        write_atomically(path, b"new")
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

    with pytest.raises(DockctlError, match="best"):
        fail()
    assert names(tmp_path / "best") == ["one"]


def test_a_table_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(DockctlError, match=r"t\.csv"):
        Table(tmp_path / "t.csv", ["a"]).append([{"a": 1}])


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
