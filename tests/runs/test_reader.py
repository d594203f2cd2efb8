"""Reading a run folder, whole, partial or broken."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.reader import read_run
from tests.reports.synthetic import write_run


def test_a_run_is_read(tmp_path: Path) -> None:
    run = read_run(write_run(tmp_path / "run", poses=2, count=30))
    assert (run.scenario, run.seed, run.caption) == ("made-up", 3, "scenario made-up, seed 3")
    assert run.episodes is not None
    assert len(run.episodes) == 30
    assert run.missing == []
    assert [pose.heading_deg for pose in run.tests] == [160.0, 150.0]


@pytest.mark.parametrize("content", [None, "", "pose,step\n"])
def test_missing_empty_and_bare_tables_are_left_out(tmp_path: Path, content: str | None) -> None:
    folder = write_run(tmp_path / "run", count=20)
    evaluations = folder / "evaluations.csv"
    header = evaluations.read_text().splitlines()[0] + "\n"
    evaluations.unlink()
    if content is not None:
        evaluations.write_text(header if content else "")
    assert read_run(folder).missing == ["evaluations.csv"]


def test_a_run_without_any_table_says_so(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / "episodes.csv").unlink()
    (folder / "trajectories.csv").write_text("")
    with pytest.raises(DockctlError, match=r"nothing to plot yet: episodes\.csv and trajectories\.csv"):
        read_run(folder)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("episodes.csv", "episode,steps\n1,2\n", "lacks the columns: start_kind, return, outcome"),
        ("episodes.csv", "\x00\xff", "episodes.csv: cannot be read"),
        ("scene.json", "{", "scene.json: cannot be read"),
        ("scene.json", "[]", "scene.json: cannot be read"),
        ("scenario.yaml", "name: x\n", "not the resolved scenario"),
        ("scenario.yaml", "a: [", "not the resolved scenario"),
        ("scenario.yaml", "name: x\ntask: {final: 3}\ntraining: {seed: 1}\n", "not the resolved scenario"),
    ],
)
def test_broken_files_are_named(tmp_path: Path, name: str, content: str, message: str) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / name).write_text(content, encoding="latin-1")
    with pytest.raises(DockctlError, match=message) as caught:
        read_run(folder)
    assert name in str(caught.value)


def test_another_folder_is_not_a_run(tmp_path: Path) -> None:
    with pytest.raises(DockctlError, match="not a run folder"):
        read_run(tmp_path)
