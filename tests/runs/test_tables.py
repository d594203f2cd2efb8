"""Tables: complete rows, one header, repeatable numbers."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.runs.tables import Table, to_csv


def test_the_first_row_adds_columns(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    table = Table(path, ["a", "b"])
    assert not path.exists()
    table.append([])
    assert not path.exists()
    table.append([{"b": 0.1 + 0.2, "a": 1, "reward_x": True}])
    Table(path, ["a", "b"]).append([{"a": "words, more", "b": None, "reward_x": 1234567.0}])
    assert path.read_text() == 'a,b,reward_x\n1,0.3,1\n"words, more",,1.23457e+06\n'


@pytest.mark.parametrize(
    ("until", "left"),
    [(5, ""), (10, "10,1\n10,2\n"), (25, "10,1\n10,2\n20,3\n"), (99, "10,1\n10,2\n20,3\n30,4\n")],
)
def test_rows_after_a_step_are_removed_from_a_table_of_an_early_version(
    tmp_path: Path, until: int, left: str
) -> None:
    def restored(text: str) -> str:
        (tmp_path / "t.csv").write_text(text)
        assert Table(tmp_path / "t.csv", []).restore(None, until) is None
        return (tmp_path / "t.csv").read_text()

    assert restored("env_steps,x\n10,1\n10,2\n20,3\n30,4\n31") == "env_steps,x\n" + left
    assert restored("env_st") == ""


ROWS = [b"10,1\n", b"20,2\n", b"30,3\n"]
WHOLE = b"env_steps,x\n" + b"".join(ROWS)


@pytest.mark.parametrize(
    ("damaged", "left"),
    [
        (WHOLE[:-2], ROWS[:2]),
        (WHOLE[:-5] + bytes(5), ROWS[:2]),
        (WHOLE.replace(b"20,2", b"2\0,2"), [ROWS[0], ROWS[2]]),
        (WHOLE.replace(b"20,2", b"20,\xff"), [ROWS[0], ROWS[2]]),
        (WHOLE.replace(b"20,2", b"20"), [ROWS[0], ROWS[2]]),
        (bytes(len(WHOLE)), []),
        (b"", []),
        (None, []),
    ],
)
def test_what_a_damaged_table_has_lost_is_reported(
    tmp_path: Path, damaged: bytes | None, left: list[bytes]
) -> None:
    path = tmp_path / "t.csv"
    table = Table(path, ["env_steps", "x"])
    table.append([{"env_steps": step, "x": step // 10} for step in (10, 20, 30)])
    saved = table.save()
    table.append([{"env_steps": 40, "x": 4}])
    if damaged is None:
        path.unlink()
    else:
        path.write_bytes(damaged)
    lost = Table(path, ["env_steps", "x"]).restore(saved, 30)
    assert lost is not None
    assert lost.startswith(f"{path}: ")
    assert f" {3 - len(left)} of 3 " in lost
    assert (path.read_bytes() if path.exists() else b"").splitlines(keepends=True)[1:] == left


def test_a_restored_table_continues(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    first = Table(path, ["env_steps", "x"])
    assert Table(tmp_path / "none.csv", ["env_steps"]).restore(first.save(), 0) is None
    first.append([{"env_steps": 10, "x": 1, "extra": 2}])
    saved = first.save()
    first.append([{"env_steps": 20, "x": 1, "extra": 2}])
    again = Table(path, ["env_steps", "x"])
    assert again.restore(saved, 10) is None
    assert again.save() == saved
    again.append([{"env_steps": 11, "extra": 3, "x": 4}])
    assert path.read_text() == "env_steps,x,extra\n10,1,2\n11,4,3\n"


def test_csv_text() -> None:
    assert to_csv([{"x": 1.0}, {"x": float("nan")}], ["x", "y"]) == "x,y\n1,\nnan,\n"
