"""Archived runs: small, without paths of the machine, reproducible bytes, read like run folders."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from dockctl.errors import DockctlError
from dockctl.experiments.archive import TRAJECTORIES, UPDATE_ROWS, archive
from dockctl.run_files import TRANSFER
from dockctl.runs.reader import read_run, read_table
from tests.reports.synthetic import marina, track, write_run


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = write_run(tmp_path / "run")
    facts = {
        "seed": 3, "git_commit": "abc", "command": ["dockctl", "--out", "/home/somebody"],
        "hardware": {"processor": "a processor", "cores": 2, "platform": "Linux"}, "libraries": {},
    }  # fmt: skip
    (folder / "provenance.json").write_text(json.dumps(facts))
    updates = pd.DataFrame({"update": range(1, 1502), "env_steps": range(1, 1502), "loss": 0.5})
    updates.to_csv(folder / "updates.csv", index=False)
    (folder / "evaluation.csv").write_text("start_kind,outcome\npose,docked\n")
    (folder / "evaluation.json").write_text('{"policy": "/home/somebody"}')
    (folder / "figures").mkdir()
    (folder / "figures" / "latency.csv").write_text("decision,forward_ms\n0,0.1\n")
    return folder


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def test_archived_run_reads_like_the_run(run: Path, tmp_path: Path) -> None:
    archived = read_run(archive(run, tmp_path / "results", "s1", 3))
    whole = read_run(run)
    assert archived.episodes is not None
    assert whole.episodes is not None
    pd.testing.assert_frame_equal(archived.episodes, whole.episodes)
    assert archived.scene.to_json() == marina().to_json()
    assert (archived.task, archived.seed) == (whole.task, 3)


def test_archiving_again_gives_the_same_bytes(run: Path, tmp_path: Path) -> None:
    first, again = (files(archive(run, tmp_path / "results", "s1", 3)) for _ in range(2))
    assert first == again


def test_no_path_of_the_machine_is_archived(run: Path, tmp_path: Path) -> None:
    archive(run, tmp_path / "results", "s1", 3)
    assert not [name for name, content in files(tmp_path / "results").items() if b"/home" in content]
    facts = json.loads((tmp_path / "results" / "s1" / "seed3" / "provenance.json").read_text())
    assert (facts["processor"], facts["cores"], facts["git_commit"]) == ("a processor", 2, "abc")


def test_long_tables_are_thinned_but_include_the_last_row(run: Path, tmp_path: Path) -> None:
    many = [track(pose, (20.0, 2.0, 160.0), steps=3) for pose in range(TRAJECTORIES + 3)]
    pd.concat(many).to_csv(run / "trajectories.csv", index=False)
    archived = archive(run, tmp_path / "results", "s1", 3)
    updates = read_table(archived / "updates.csv", ("update",))
    assert updates is not None
    assert len(updates) <= UPDATE_ROWS
    assert updates["update"].iloc[-1] == 1501
    trajectories = read_table(archived / "trajectories.csv", ("pose",))
    assert trajectories is not None
    assert sorted(trajectories["pose"].unique()) == list(range(TRAJECTORIES))


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scene.json", None),
        ("scene.json", b"{"),
        ("scene.json", b"[]"),
        ("scene.json", b"{}"),
        ("scenario.yaml", None),
        ("trajectories.csv", b"step,x_m\n0,1\n"),
        ("trajectories.csv", b"pose,step\nfirst,0\n"),
        ("episodes.csv", b"\xff\xfe"),
        ("updates.csv", b""),
        ("provenance.json", b"{"),
    ],
)
def test_damaged_run_is_rejected_and_the_earlier_archive_is_unchanged(
    run: Path, tmp_path: Path, name: str, content: bytes | None
) -> None:
    archive(run, tmp_path / "results", "s1", 3)
    before = files(tmp_path / "results")
    if content is None:
        (run / name).unlink()
    else:
        (run / name).write_bytes(content)
    with pytest.raises(DockctlError, match=name) as caught:
        archive(run, tmp_path / "results", "s1", 3)
    assert caught.value.code == ("not_found" if content is None else "not_readable")
    archived = {
        path: content for path, content in files(tmp_path / "results").items() if ".seed3.new" not in path
    }
    assert archived == before


@pytest.mark.parametrize("table", ["episodes.csv.gz", "scenes"])
def test_damaged_archive_is_rejected(run: Path, tmp_path: Path, table: str) -> None:
    archived = archive(run, tmp_path / "results", "s1", 3)
    file = next((tmp_path / "results" / "scenes").iterdir()) if table == "scenes" else archived / table
    content = bytearray(file.read_bytes())
    content[12:40] = bytes([255]) * 28
    file.write_bytes(bytes(content))
    with pytest.raises(DockctlError, check=lambda error: error.code == "not_readable"):
        read_run(archived)


def test_recordings_are_archived_and_share_one_scene_file(run: Path, tmp_path: Path) -> None:
    write_run(run / TRANSFER / "s3-opposite", intermediate=True)
    archived = archive(run, tmp_path / "results", "s1", 3)
    assert read_run(archived / TRANSFER / "s3-opposite").task.intermediate is not None
    assert len(list((tmp_path / "results" / "scenes").iterdir())) == 1
