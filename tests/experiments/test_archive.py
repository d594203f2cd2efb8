"""Kept runs: small, free of the machine's paths, the same bytes each time, and drawn like run folders."""

from __future__ import annotations

import json
from pathlib import Path

import pandas as pd
import pytest

from dockctl.errors import DockctlError
from dockctl.experiments.archive import ELSEWHERE, TRACKS, UPDATE_ROWS, keep
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


def test_a_kept_run_is_read_like_the_run_itself(run: Path, tmp_path: Path) -> None:
    kept = read_run(keep(run, tmp_path / "results", "s1", 3))
    whole = read_run(run)
    assert kept.episodes is not None
    assert whole.episodes is not None
    pd.testing.assert_frame_equal(kept.episodes, whole.episodes)
    assert kept.scene.to_json() == marina().to_json()
    assert (kept.task, kept.seed) == (whole.task, 3)


def test_keeping_again_gives_the_same_bytes(run: Path, tmp_path: Path) -> None:
    first, again = (files(keep(run, tmp_path / "results", "s1", 3)) for _ in range(2))
    assert first == again


def test_no_path_of_the_machine_is_kept(run: Path, tmp_path: Path) -> None:
    keep(run, tmp_path / "results", "s1", 3)
    assert not [name for name, content in files(tmp_path / "results").items() if b"/home" in content]
    facts = json.loads((tmp_path / "results" / "s1" / "seed3" / "provenance.json").read_text())
    assert (facts["processor"], facts["cores"], facts["git_commit"]) == ("a processor", 2, "abc")


def test_long_tables_are_thinned_and_keep_their_end(run: Path, tmp_path: Path) -> None:
    many = [track(pose, (20.0, 2.0, 160.0), steps=3) for pose in range(TRACKS + 3)]
    pd.concat(many).to_csv(run / "trajectories.csv", index=False)
    kept = keep(run, tmp_path / "results", "s1", 3)
    updates = read_table(kept / "updates.csv", ("update",))
    assert updates is not None
    assert len(updates) <= UPDATE_ROWS
    assert updates["update"].iloc[-1] == 1501
    trajectories = read_table(kept / "trajectories.csv", ("pose",))
    assert trajectories is not None
    assert sorted(trajectories["pose"].unique()) == list(range(TRACKS))


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
def test_a_run_with_a_broken_file_is_refused_and_what_was_kept_stays(
    run: Path, tmp_path: Path, name: str, content: bytes | None
) -> None:
    keep(run, tmp_path / "results", "s1", 3)
    before = files(tmp_path / "results")
    if content is None:
        (run / name).unlink()
    else:
        (run / name).write_bytes(content)
    with pytest.raises(DockctlError, match=rf"{name}: cannot be read: "):
        keep(run, tmp_path / "results", "s1", 3)
    kept = {
        path: content for path, content in files(tmp_path / "results").items() if ".seed3.new" not in path
    }
    assert kept == before


@pytest.mark.parametrize("table", ["episodes.csv.gz", "scenes"])
def test_a_kept_file_that_is_damaged_inside_is_refused(run: Path, tmp_path: Path, table: str) -> None:
    kept = keep(run, tmp_path / "results", "s1", 3)
    file = next((tmp_path / "results" / "scenes").iterdir()) if table == "scenes" else kept / table
    content = bytearray(file.read_bytes())
    content[12:40] = bytes([255]) * 28
    file.write_bytes(bytes(content))
    with pytest.raises(DockctlError, match="cannot be read"):
        read_run(kept)


def test_recordings_are_kept_and_one_plan_serves_all(run: Path, tmp_path: Path) -> None:
    write_run(run / ELSEWHERE / "s3-opposite", intermediate=True)
    kept = keep(run, tmp_path / "results", "s1", 3)
    assert read_run(kept / ELSEWHERE / "s3-opposite").task.intermediate is not None
    assert len(list((tmp_path / "results" / "scenes").iterdir())) == 1
