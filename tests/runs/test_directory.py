"""Run folders: never overwritten, written atomically, found by name and by date."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest

from dockctl.errors import DockctlError
from dockctl.run_files import RUNS
from dockctl.runs import directory
from dockctl.runs.directory import RunDirectory, default_policy
from dockctl.runs.files import require_replaceable, require_writable


def has_code(code: str) -> Callable[[DockctlError], bool]:
    return lambda error: error.code == code


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


@pytest.fixture
def frozen_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    class Clock(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:
            return datetime(2025, 3, 1, 14, 30, 59, tzinfo=timezone(timedelta(hours=2))).astimezone(tz)

    monkeypatch.setattr(directory, "datetime", Clock)


@pytest.mark.usefixtures("frozen_clock")
def test_runs_started_in_the_same_second_get_separate_folders(tmp_path: Path) -> None:
    made = [RunDirectory.create(tmp_path, "s1", 4).path.relative_to(tmp_path).as_posix() for _ in range(3)]
    assert made == [f"s1/20250301-123059-seed4{suffix}" for suffix in ("", "-2", "-3")]


def start(root: Path, name: str, *, checkpoint: bool = True, sequence: bool = True) -> Path:
    """Make a run folder as a training does."""
    facts = {"sequence": RunDirectory.next_sequence(root)} if sequence else {}
    run = RunDirectory(root / name)
    run.path.mkdir(parents=True)
    run.write_text("scenario.yaml", "")
    run.write_json("provenance.json", facts)
    if checkpoint:
        run.checkpoint("last").mkdir(parents=True)
    return run.path


def test_the_latest_run_is_the_one_started_last_whatever_the_clock_shows(tmp_path: Path) -> None:
    with pytest.raises(DockctlError, check=has_code("not_found")):
        RunDirectory.latest(tmp_path)
    early = [
        start(tmp_path, f"s1/{name}", sequence=False)
        for name in ("20250301-000000-seed0", "20250201-000000-seed9")
    ]
    assert RunDirectory.latest(tmp_path).path == early[0]  # runs of early versions have only their names
    for name in ("s2/20250101-000000-seed10", "s3/20240101-000000-seed9", "s1/20240101-000000-seed10"):
        last = start(tmp_path, name)
        assert RunDirectory.latest(tmp_path).path == last


def test_the_runs_of_a_sweep_count_among_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    sweep = RUNS / "sweep" / "s1" / "gamma-0.9"
    for root, seed in ((RUNS, 0), (sweep, 1), (sweep, 0), (RUNS, 1), (sweep, 2)):
        last = start(root, f"s1/20250101-000000-seed{seed}")
        assert RunDirectory.latest(RUNS).path == last


def test_the_default_policy_is_the_latest_run_or_a_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert [default_policy(name) for name in (None, "s1", "marina", "s3-opposite")] == [
        "s3",
        "s1",
        "marina",
        "s3",
    ]
    run = start(RUNS, "s2/20250101-000000-seed0")
    for name in (None, "s1"):
        chosen = default_policy(name)
        assert isinstance(chosen, RunDirectory) and chosen.path == run


def test_a_start_that_failed_is_not_the_latest_run(tmp_path: Path) -> None:
    start(tmp_path, "s1/20250101-000000-seed0", checkpoint=False)
    with pytest.raises(DockctlError, check=has_code("not_found")):
        RunDirectory.latest(tmp_path)
    good = start(tmp_path, "s1/20250102-000000-seed0")
    failed = start(tmp_path, "s1/20250103-000000-seed0", checkpoint=False)
    (failed / "provenance.json").write_bytes(bytes(9))
    assert RunDirectory.latest(tmp_path).path == good


def test_only_a_run_folder_can_be_opened(tmp_path: Path) -> None:
    run = RunDirectory.create(tmp_path, "s1", 0)
    with pytest.raises(DockctlError, check=has_code("not_found")):
        RunDirectory.open(run.path)
    run.write_text("scenario.yaml", "name: s1\n")
    assert RunDirectory.open(run.path).path == run.path
    with pytest.raises(DockctlError, check=has_code("not_found")):
        RunDirectory.open(tmp_path / "nowhere")
    run.write_text("provenance.json", "{")
    with pytest.raises(DockctlError, match=r"provenance\.json", check=has_code("not_readable")):
        run.read_json("provenance.json")


def test_the_run_that_contains_a_checkpoint(tmp_path: Path) -> None:
    run = RunDirectory.create(tmp_path, "s1", 0)
    file = run.checkpoint("best") / "policy.json"
    assert RunDirectory.containing(file) is None
    run.write_text("scenario.yaml", "")
    run_of_file = RunDirectory.containing(file)
    assert run_of_file is not None
    assert run_of_file.path == run.path


def test_unwritable_places_are_reported_before_any_work(tmp_path: Path) -> None:
    require_writable(tmp_path / "new" / "deep")
    assert names(tmp_path) == []
    (tmp_path / "file").touch()
    for call in (require_writable, lambda root: RunDirectory.create(root, "s1", 0)):
        with pytest.raises(DockctlError, match=str(tmp_path), check=has_code("not_writable")):
            call(tmp_path / "file" / "runs")


def test_a_folder_without_write_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root has every right
    with pytest.raises(DockctlError, match=str(tmp_path), check=has_code("not_writable")):
        require_writable(tmp_path / "runs")


def test_plugins_are_copied_with_their_hashes(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(f"# {folder}\n")
    run = RunDirectory.create(tmp_path / "runs", "s1", 0)
    hashes = run.copy_files("plugins", [tmp_path / "a" / "mine.py", tmp_path / "b" / "mine.py"])
    assert list(hashes) == ["plugins/00-mine.py", "plugins/01-mine.py"]
    assert hashes["plugins/01-mine.py"] == hashlib.sha256(b"# b\n").hexdigest()
    assert (run.path / "plugins" / "00-mine.py").read_text() == "# a\n"


def test_the_last_checkpoints_are_kept(tmp_path: Path) -> None:
    run = RunDirectory(tmp_path)
    for number in range(5):
        with run.new_checkpoint("last") as folder:
            (folder / f"{number}").touch()
        kept = [names(folder) for folder in run.checkpoints("last")]
        assert kept == [[f"{i}"] for i in range(number, max(number - 3, -1), -1)]
    assert {*names(tmp_path / "checkpoints")} == {"last", "last-1", "last-2"}
    assert run.checkpoint("last") == tmp_path / "checkpoints" / "last"
    shutil.rmtree(run.checkpoint("last"))  # killed before the new one got its name
    assert names(run.checkpoint("last")) == ["3"]
    with run.new_checkpoint("last") as folder:
        (folder / "5").touch()
    assert [names(folder) for folder in run.checkpoints("last")] == [["5"], ["3"], ["2"]]


def test_only_an_earlier_version_is_replaced(tmp_path: Path) -> None:
    def check(folder: Path) -> None:
        require_replaceable(folder, ("a", "b"), ("c",), "thing")

    thing = tmp_path / "thing"
    check(thing)
    thing.mkdir()
    check(thing)
    (thing / "a").touch()
    with pytest.raises(DockctlError, match=str(thing), check=has_code("not_writable")):
        check(thing)
    (thing / "b").touch()
    (thing / "c").mkdir()
    check(thing)
    (thing / "mine").touch()
    with pytest.raises(DockctlError, match=str(thing), check=has_code("not_writable")):
        check(thing)
    with pytest.raises(DockctlError, match=str(thing), check=has_code("not_writable")):
        check(thing / "a")


@pytest.mark.parametrize(
    "error", [PermissionError(13, "Permission denied"), OSError(36, "File name too long")]
)
def test_an_inaccessible_place_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError
) -> None:
    stat = os.stat

    def closed(path: Any, *given: Any, **named: Any) -> os.stat_result:
        if str(path).startswith(str(tmp_path / "closed")):
            raise error
        return stat(path, *given, **named)

    monkeypatch.setattr(os, "stat", closed)
    require_writable(tmp_path / "closed")
    assert RunDirectory.containing(tmp_path / "closed" / "checkpoints" / "best" / "policy.json") is None
    with pytest.raises(DockctlError, check=has_code("not_found")):
        RunDirectory.open(tmp_path / "closed")
