"""`dockctl compare`: the same starts for all, files, output, errors."""

from __future__ import annotations

import csv
import json
import shutil
from importlib import import_module
from pathlib import Path

import pandas as pd
import pytest

from dockctl.runs.tables import EVALUATION
from tests.commands.conftest import Outcome, dockctl

Trained = tuple[Path, Outcome]


@pytest.mark.slow
def test_two_policies_from_the_same_starts(trained: Trained, tmp_path: Path) -> None:
    best, last = (trained[0] / "checkpoints" / name for name in ("best", "last"))
    outcome = dockctl(
        "compare", best, last, "--scenario", "s2", "--episodes", 3, "--seed", 5,
        "--csv", tmp_path / "c.csv", "--json", tmp_path / "c.json", "--out", tmp_path / "figures",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    for words in ("Random starts, seed 5, scenario 's2'", "against best", "exact McNemar p = "):
        assert words in outcome.out
    rows = list(csv.DictReader((tmp_path / "c.csv").read_text().splitlines()))
    assert list(rows[0]) == ["policy", *EVALUATION]
    where = [
        [
            [row[key] for key in ("start_kind", "x_m", "y_m", "heading_deg")]
            for row in rows
            if row["policy"] == p
        ]
        for p in ("best", "last")
    ]
    assert where[0] == where[1]
    assert len(where[0]) == 5 + 3
    result = json.loads((tmp_path / "c.json").read_text())
    assert (result["scenario"], list(result["policies"])) == ("s2", ["best", "last"])
    (difference,) = result["differences"]
    assert (difference["starts"], difference["docked"]["pairs"]) == ("random", 3)
    assert sorted(path.name for path in (tmp_path / "figures").iterdir()) == [
        f"compare-s2-{trained[0].name}-{trained[0].name}-last.{suffix}" for suffix in ("png", "svg")
    ]


def test_a_policy_does_not_differ_from_itself(trained: Trained, tmp_path: Path) -> None:
    run = trained[0]
    outcome = dockctl("compare", run, run, "--json", tmp_path / "c.json", "--out", tmp_path)
    assert outcome.code == 0, outcome.err
    (difference,) = json.loads((tmp_path / "c.json").read_text())["differences"]
    assert (difference["docked"]["value"], difference["mcnemar_p"]) == (0, 1)
    assert difference["second"] == f"{run.name} (2)"


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("folders", "names"),
    [
        (("s1/20260101-seed0", "s1/20260102-seed0"), {"20260101-seed0", "20260102-seed0"}),
        (("gamma-0.95/s1/20260101-seed0", "gamma-0.99/s1/20260101-seed0"), {"gamma-0.95", "gamma-0.99"}),
    ],
)
def test_runs_of_one_scenario_and_seed_are_named_by_the_folders_that_differ(
    trained: Trained, tmp_path: Path, folders: tuple[str, str], names: set[str]
) -> None:
    copies = [shutil.copytree(trained[0], tmp_path / folder) for folder in folders]
    outcome = dockctl("compare", *copies, "--trust", "--json", tmp_path / "c.json", "--out", tmp_path)
    assert outcome.code == 0, outcome.err
    assert set(json.loads((tmp_path / "c.json").read_text())["policies"]) == names


@pytest.mark.thorough
def test_runs_of_one_scenario_and_seed_have_the_names_they_were_given(
    trained: Trained, tmp_path: Path
) -> None:
    copies = [shutil.copytree(trained[0], tmp_path / folder) for folder in ("first", "second", "third")]
    for run, name in zip(copies[:2], ("narrow", "wide"), strict=True):
        facts = json.loads((run / "provenance.json").read_text())
        (run / "provenance.json").write_text(json.dumps({**facts, "name": name}))
    outcome = dockctl("compare", *copies, "--trust", "--json", tmp_path / "c.json", "--out", tmp_path)
    assert outcome.code == 0, outcome.err
    assert list(json.loads((tmp_path / "c.json").read_text())["policies"]) == ["narrow", "wide", "third"]


@pytest.mark.thorough
def test_a_policy_is_compared_with_itself_under_a_changed_value(trained: Trained, tmp_path: Path) -> None:
    fault = "conditions.lidar_faults={sectors: [1, 2]}"
    arguments = ("compare", trained[0], "--vary", fault, "--json", tmp_path / "c.json", "--out", tmp_path)
    outcome = dockctl(*arguments, "--csv", tmp_path / "c.csv")
    assert outcome.code == 0, outcome.err
    result = json.loads((tmp_path / "c.json").read_text())
    plain, faulty = result["policies"]
    assert faulty == f"{plain}, {fault}"
    assert [each["set"] for each in result["policies"].values()] == [[], [fault]]
    (difference,) = result["differences"]
    assert (difference["first"], difference["second"]) == (plain, faulty)
    table = pd.read_csv(tmp_path / "c.csv")
    assert table["lidar_faults_after_s"].isna().equals(table["policy"] == plain)


def test_changed_values_that_change_the_starts_are_refused(trained: Trained, tmp_path: Path) -> None:
    arguments = ("--vary", "task.initial.0.x_m=20.5", "--episodes", 1, "--out", tmp_path / "figures")
    outcome = dockctl("compare", trained[0], *arguments)
    assert (outcome.code, outcome.error_code) == (2, "mismatch")
    assert not (tmp_path / "figures").exists()


def test_a_faulty_change_is_an_error_before_the_first_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []
    # The package has a function of this name, so the module is looked up by its full name.
    monkeypatch.setattr(
        import_module("dockctl.evaluation.compare"), "evaluate", lambda *a, **k: calls.append(a)
    )
    outcome = dockctl("compare", "s1", "--vary", "task.max_stepz=9", "--out", tmp_path / "figures")
    assert (outcome.code, outcome.error_code) == (2, "unknown_key")
    assert outcome.error is not None
    assert outcome.error.suggestion == "max_steps"
    assert "--vary task.max_stepz" in str(outcome.error)
    assert not calls


def test_a_change_of_what_belongs_to_the_policy_is_named(tmp_path: Path) -> None:
    changes = ("--set", "task.max_steps=9", "--vary", "sensors.lidar.sectors=4")
    outcome = dockctl("compare", "s1", *changes, "--out", tmp_path / "figures")
    assert (outcome.code, outcome.error_code) == (2, "mismatch")
    assert str(outcome.error).startswith("--vary sensors.lidar.sectors: ")


@pytest.mark.parametrize(
    ("arguments", "code", "suggestion"),
    [
        ([], "", ""),  # reported by the option parser
        (["RUN"], "missing_key", ""),
        (["RUN", "nowhere"], "not_found", ""),
        (["RUN", "marine"], "not_found", "marina"),
        (["RUN", "RUN", "--scenario", "s33"], "unknown_name", "s3"),
        (["RUN", "RUN", "--csv", "no/such/folder.csv"], "not_writable", ""),
        (["RUN", "RUN", "--out", "a-file/figures"], "not_writable", ""),
    ],
)
def test_errors(
    trained: Trained,
    arguments: list[str],
    code: str,
    suggestion: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a-file").touch()
    outcome = dockctl("compare", *(str(trained[0]) if word == "RUN" else word for word in arguments))
    assert outcome.code == 2
    assert outcome.error_code == code
    assert outcome.error is None or outcome.error.suggestion == suggestion
    assert [path.name for path in tmp_path.iterdir()] == ["a-file"]
