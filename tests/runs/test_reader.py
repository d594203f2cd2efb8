"""Run folders that are complete, partial or damaged."""

from __future__ import annotations

import gzip
from pathlib import Path

import pandas as pd
import pytest

from dockctl.errors import Code, DockctlError
from dockctl.runs.reader import read_run
from tests.reports.synthetic import write_run


def test_a_run_is_read(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "run", poses=2, count=30))
    assert (run.scenario, run.seed, run.caption) == ("made-up", 3, "scenario made-up, seed 3")
    assert run.episodes is not None
    assert len(run.episodes) == 30
    assert run.missing == []
    assert [pose.heading_deg for pose in run.tests] == [160.0, 150.0]


@pytest.mark.parametrize("content", [None, "", "header"])
def test_missing_and_empty_tables_are_listed(tmp_path: Path, content: str | None) -> None:
    folder = write_run(tmp_path / "run", count=20)
    evaluations = folder / "evaluations.csv"
    header = evaluations.read_text().splitlines()[0] + "\n"
    evaluations.unlink()
    if content is not None:
        evaluations.write_text(header if content else "")
    assert read_run(folder).missing == ["evaluations.csv"]


def test_evaluations_of_older_runs_are_from_poses(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    old = pd.read_csv(folder / "evaluations.csv").drop(columns="start_kind")
    old.to_csv(folder / "evaluations.csv", index=False)
    read = read_run(folder).evaluations
    assert read is not None and set(read["start_kind"]) == {"pose"}


def test_gzipped_tables_are_read(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    plain = read_run(folder).episodes
    content = (folder / "episodes.csv").read_bytes()
    (folder / "episodes.csv").unlink()
    (folder / "episodes.csv.gz").write_bytes(gzip.compress(content))
    assert plain is not None
    pd.testing.assert_frame_equal(read_run(folder).episodes, plain)


def test_a_run_without_any_table(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / "episodes.csv").unlink()
    (folder / "trajectories.csv").write_text("")
    with pytest.raises(DockctlError) as caught:
        read_run(folder)
    assert caught.value.code == "not_found"
    assert str(folder) in caught.value.message


@pytest.mark.parametrize(
    ("name", "content", "code", "location"),
    [
        ("episodes.csv", "episode,steps\n1,2\n", "missing_key", "start_kind, return, outcome"),
        ("episodes.csv", "\x00\xff", None, ""),
        ("updates.csv", "env_steps,loss\n1,2\n2,high\n", "wrong_type", "updates.csv:3: loss"),
        ("updates.csv", "env_steps,loss\n1,2\n,3\n", "wrong_type", "updates.csv:3: env_steps"),
        ("updates.csv", "env_steps,loss\n1,2,3\n", "not_readable", "updates.csv"),
        ("evaluations.csv", "env_steps,pose,outcome,best\n9,1e300,docked,1\n", "wrong_type", "csv:2: pose"),
        ("evaluations.csv", "env_steps,pose,outcome,best\n9,0.5,docked,1\n", "wrong_type", "csv:2: pose"),
        ("evaluations.csv", "env_steps,pose,outcome,best\ninf,0,docked,1\n", "wrong_type", "csv:2: env"),
        ("scene.json", "{", None, ""),
        ("scene.json", "[]", None, ""),
        (
            "scene.json",
            '{"name": "x", "bounds_m": [0, 0, 1, 1], "hull_m": [[0, 0], [1, 0], [1, 1]], "polygons":'
            ' [{"kind": ["x"], "name": "x", "xy_m": [[0, 0], [1, 0], [1, 1]], "height_m": 1}]}',
            None,
            "polygon",
        ),
        ("scenario.yaml", "name: x\n", "missing_key", "task"),
        ("scenario.yaml", "a: [", "yaml_syntax", "scenario.yaml:1:5"),
        (
            "scenario.yaml",
            "name: x\ntask: {final: 3}\ntraining: {seed: 1}\n",
            None,
            "scenario.yaml:2:15: task.final",
        ),
    ],
)
def test_damaged_files(tmp_path: Path, name: str, content: str, code: Code | None, location: str) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / name).write_text(content, encoding="latin-1")
    with pytest.raises(DockctlError) as caught:
        read_run(folder)
    assert str(folder / name) in caught.value.message
    assert location in caught.value.message
    assert code in (None, caught.value.code)


def test_a_folder_that_is_not_a_run(tmp_path: Path) -> None:
    with pytest.raises(DockctlError) as caught:
        read_run(tmp_path)
    assert caught.value.code == "not_found"


@pytest.mark.parametrize("left", ["all but the end of the line", "half", "first cell"])
@pytest.mark.parametrize("name", ["episodes", "updates", "evaluations", "trajectories"])
def test_a_last_row_without_its_end_is_left_out(
    name: str, left: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A crash may leave half a row, which can look like a whole one."""
    folder = write_run(tmp_path / "run", count=20)
    path = folder / f"{name}.csv"
    _, *rows, last = path.read_text().splitlines(keepends=True)
    assert len(getattr(read_run(folder), name)) == len(rows) + 1
    assert not caplog.records
    ends = {
        "all but the end of the line": len(last) - 1,
        "half": len(last) // 2,
        "first cell": last.index(","),
    }
    path.write_text(path.read_text().removesuffix(last) + last[: ends[left]])
    assert len(getattr(read_run(folder), name)) == len(rows)
    messages = [record.getMessage() for record in caplog.records]
    assert messages == [f"{path}: the last row is incomplete and is ignored"]
