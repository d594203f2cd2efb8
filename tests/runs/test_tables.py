"""Tables: complete rows, one header, repeatable numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import DockctlError
from dockctl.runs.directory import RunDirectory
from dockctl.runs.tables import Table, cut_table, to_csv


def test_the_first_row_adds_columns(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    table = Table(path, ["a", "b"])
    assert not path.exists()
    table.append([])
    assert not path.exists()
    table.append([{"b": 0.1 + 0.2, "a": 1, "reward_x": True}])
    Table(path, ["a", "b"]).append([{"a": "words, more", "b": None, "reward_x": 1234567.0}])
    assert path.read_text() == 'a,b,reward_x\n1,0.3,1\n"words, more",,1.23457e+06\n'


def test_a_missing_table_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DockctlError, match=r"t\.csv"):
        cut_table(tmp_path / "t.csv", 10)


@pytest.mark.parametrize(
    ("until", "left"),
    [(5, ""), (10, "10,1\n10,2\n"), (25, "10,1\n10,2\n20,3\n"), (99, "10,1\n10,2\n20,3\n30,4\n")],
)
def test_rows_after_a_step_are_removed(tmp_path: Path, until: int, left: str) -> None:
    run = RunDirectory(tmp_path)
    (tmp_path / "t.csv").write_text("env_steps,x\n10,1\n10,2\n20,3\n30,4\n31")
    run.cut_table("t.csv", until)
    assert (tmp_path / "t.csv").read_text() == "env_steps,x\n" + left
    (tmp_path / "begun.csv").write_text("env_st")
    run.cut_table("begun.csv", 10)
    assert (tmp_path / "begun.csv").read_text() == ""
    run.cut_table("absent.csv", 10)
    assert not (tmp_path / "absent.csv").exists()


def test_csv_text() -> None:
    assert to_csv([{"x": 1.0}, {"x": float("nan")}], ["x", "y"]) == "x,y\n1,\nnan,\n"
