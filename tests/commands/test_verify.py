"""``dockctl verify``: the first steps of a training are repeated and compared."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from dockctl.experiments.verify import verify
from tests.commands.conftest import dockctl


def test_a_run_repeats_on_this_machine(run: Path) -> None:
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    result = verify(run, 200)
    assert result.is_equal
    assert {table.name: table.rows for table in result.tables} == {
        name: sum(int(row["env_steps"]) <= 200 for row in csv.DictReader((run / name).open()))
        for name in ("episodes.csv", "updates.csv", "evaluations.csv")
    }
    assert all(table.rows for table in result.tables)
    assert result.conditions == ()
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    assert dockctl("verify", run, "--steps", 50).code == 0


@pytest.mark.parametrize(
    ("name", "column"),
    [
        ("episodes.csv", "return"),
        pytest.param("updates.csv", "loss", marks=pytest.mark.thorough),
        pytest.param("evaluations.csv", "outcome", marks=pytest.mark.thorough),
    ],
)
def test_a_row_that_differs(run: Path, name: str, column: str) -> None:
    rows = list(csv.DictReader((run / name).open()))
    rows[0][column] = "1.23"
    with (run / name).open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    result = verify(run, 150)
    assert not result.is_equal
    (table,) = (table for table in result.tables if table.difference)
    assert table.name == name
    assert f"row 1, {column}" in table.difference
    assert table.recorded != table.here
    assert dockctl("verify", run, "--steps", 150).code == 1


def drop(run: Path) -> None:
    lines = (run / "episodes.csv").read_text().splitlines(keepends=True)
    (run / "episodes.csv").write_text("".join(lines[:1] + lines[2:]))


def cut(run: Path) -> None:
    """Leave out the last row of the first 150 steps, and those after them."""
    lines = (run / "updates.csv").read_text().splitlines(keepends=True)
    steps = [int(row["env_steps"]) for row in csv.DictReader(lines)]
    (run / "updates.csv").write_text("".join(lines[: sum(number <= 150 for number in steps)]))


def lost(run: Path) -> None:
    (run / "evaluations.csv").unlink()


def other_seed(run: Path) -> None:
    text = (run / "scenario.yaml").read_text()
    assert "seed: 3" in text
    (run / "scenario.yaml").write_text(text.replace("seed: 3", "seed: 4"))


@pytest.mark.parametrize("change", [drop, cut, lost, other_seed])
def test_another_training(run: Path, change: Callable[[Path], None]) -> None:
    change(run)
    assert not verify(run, 150).is_equal


def test_what_differs_on_this_machine(run: Path) -> None:
    facts = json.loads((run / "provenance.json").read_text())
    numpy = facts["libraries"]["numpy"]
    facts["libraries"]["numpy"] = "1.0"
    facts["hardware"]["processor"] = "another"
    facts["packages"] = {"some-terms": {"version": "2", "sha256": "0"}}
    facts["plugins"] = {"plugins/00-gone.py": "0"}
    (run / "provenance.json").write_text(json.dumps(facts))
    differs = {name: (before, here) for name, before, here in verify(run, 20).conditions}
    assert differs.pop("libraries numpy") == ("1.0", numpy)
    assert differs.pop("hardware processor")[0] == "another"
    assert differs == {
        "packages some-terms version": ("2", "-"),
        "packages some-terms sha256": ("0", "-"),
        "plugins plugins/00-gone.py": ("0", "-"),
    }


def test_an_extended_training_is_repeated_up_to_its_extension(run: Path) -> None:
    assert dockctl("train", "--resume", run, "--steps", 400).code == 0
    result = verify(run, 350)
    assert result.is_equal
    assert result.steps == 299


def test_texts_of_the_run_are_no_markup(run: Path) -> None:
    facts = json.loads((run / "provenance.json").read_text())
    facts["python"] = "[/red]"
    (run / "provenance.json").write_text(json.dumps(facts))
    table = run / "evaluations.csv"
    table.write_text(table.read_text().replace("timeout", "[/red]"))
    outcome = dockctl("verify", run, "--steps", 120)
    assert outcome.code == 1
    assert outcome.out.count("[/red]") == 2


def test_a_folder_without_rows(run: Path) -> None:
    for name in ("episodes.csv", "updates.csv", "evaluations.csv"):
        (run / name).unlink()
    outcome = dockctl("verify", run)
    assert (outcome.code, outcome.error_code) == (2, "not_found")


def test_steps_without_rows_are_no_success(run: Path) -> None:
    outcome = dockctl("verify", run, "--steps", 1)
    assert (outcome.code, outcome.error_code) == (2, "not_found")
