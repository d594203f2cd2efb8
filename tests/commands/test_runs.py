"""`dockctl runs`: what is listed, and that `clean` deletes only what it says, and only with --yes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from dockctl.agents.checkpoint import find_policy
from dockctl.agents.training_state import load_state
from dockctl.experiments.archive import archive
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import exclusive_lock
from tests.commands.conftest import Outcome, dockctl


@pytest.fixture
def root(trained: tuple[Path, Outcome], tmp_path: Path) -> Path:
    """A finished run, one that is interrupted, one without a checkpoint, and one in a subfolder."""
    root = tmp_path / "runs"
    for name in ("s1/finished", "s1/interrupted", "s1/empty", "reproduce/study/s1/deep"):
        shutil.copytree(trained[0], root / name)
    change(root / "s1/interrupted", finished=None, stop_reason="interrupted")
    change(root / "s1/finished", name="mine", tags=["a", "b"])
    change(root / "s1/empty", finished=None, stop_reason=None)
    shutil.rmtree(root / "s1/empty/checkpoints")
    shutil.copytree(
        root / "s1/finished/checkpoints/last", root / "s1/finished/checkpoints/last-1", dirs_exist_ok=True
    )
    (root / "s1/finished/checkpoints/blocks").mkdir(exist_ok=True)
    (root / "s1/finished/checkpoints/blocks/unused.safetensors").write_bytes(b"x" * 1000)
    shutil.rmtree(root / "reproduce/study/s1/deep/checkpoints/last-1", ignore_errors=True)
    shutil.rmtree(root / "reproduce/study/s1/deep/checkpoints/last-2", ignore_errors=True)
    shutil.rmtree(root / "reproduce/study/s1/deep/checkpoints/best-1", ignore_errors=True)
    return root


def change(run: Path, **facts: Any) -> None:
    path = run / "provenance.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | facts))


def listed(root: Path) -> dict[str, dict[str, Any]]:
    rows = json.loads(dockctl("runs", "--root", root, "--json", "-").out)
    return {Path(row["path"]).name: row for row in rows}


def files(root: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in root.rglob("*") if path.is_file() and path.name != ".lock"}


def test_the_list(root: Path) -> None:
    found = listed(root)
    assert set(found) == {"finished", "interrupted", "empty", "deep"}
    mine = found["finished"]
    assert (mine["name"], mine["scenario"], mine["seed"], mine["state"]) == ("mine", "s1", 3, "finished")
    assert (mine["tags"], mine["env_steps"], mine["measured"]) == (["a", "b"], 300, "validation")
    assert 0 <= mine["success"] <= 1
    assert mine["size"] == sum(
        path.stat().st_size for path in (root / "s1/finished").rglob("*") if path.is_file()
    )
    assert found["interrupted"]["state"] == "interrupted"
    with (root / "s1/interrupted/episodes.csv").open("a") as table:  # an episode after the last evaluation
        table.write("900,11424\n")
    assert listed(root)["interrupted"]["env_steps"] == 11_424
    change(root / "s1/interrupted", stop_reason="diverged")
    (root / "s1/empty/provenance.json").write_text("{")
    with exclusive_lock(root / "s1/finished"):
        states = {name: row["state"] for name, row in listed(root).items()}
    assert states == {
        "finished": "training",
        "interrupted": "diverged",
        "empty": "damaged",
        "deep": "finished",
    }
    table = dockctl("runs", "--root", root)
    assert (table.code, "mine" in table.out) == (0, True)


def test_success_is_that_of_the_evaluation(root: Path) -> None:
    (root / "s1/finished/evaluation.json").write_text(json.dumps({"random_starts": {"success": 0.75}}))
    assert (listed(root)["finished"]["success"], listed(root)["finished"]["measured"]) == (0.75, "evaluation")
    (root / "s1/finished/evaluation.json").write_text(json.dumps({"random_starts": 3}))
    assert listed(root)["finished"]["measured"] == "validation"


def test_an_evaluation_of_an_earlier_policy_does_not_count(root: Path) -> None:
    current = json.loads(find_policy(root / "s1/finished").read_text())["sha256"]
    for policy, measured in ((current, "evaluation"), ("of an earlier one", "validation")):
        facts = {"policy": {"sha256": policy}, "random_starts": {"success": 0.75}}
        (root / "s1/finished/evaluation.json").write_text(json.dumps(facts))
        assert listed(root)["finished"]["measured"] == measured


def test_clean_deletes_only_with_yes_and_only_what_it_lists(root: Path) -> None:
    before = files(root)
    outcome = dockctl("runs", "clean", "--root", root, "--json", "-")
    found = {Path(row["run"]).name: row for row in json.loads(outcome.out)["found"]}
    assert {name: row["reason"] for name, row in found.items()} == {
        "finished": "older checkpoints",
        "empty": "no checkpoint",
    }
    assert files(root) == before
    assert dockctl("runs", "clean", "--root", root, "--yes").code == 0
    gone = [Path(path) for row in found.values() for path in row["paths"]]
    after = files(root)
    assert after == {
        path: content
        for path, content in before.items()
        if not any(path.is_relative_to(place) for place in gone)
    }
    size = sum(len(content) for path, content in before.items() if path not in after)
    assert size == pytest.approx(sum(row["size"] for row in found.values()), abs=10)
    run = RunDirectory(root / "s1/finished")
    assert sorted(path.name for path in (run.path / "checkpoints").iterdir()) == ["best", "blocks", "last"]
    assert find_policy(run.path) == run.path / "checkpoints/best/policy.json"
    assert load_state(run).env_steps == 300
    assert json.loads(dockctl("runs", "clean", "--root", root, "--json", "-").out)["found"] == []


def test_a_finished_run_without_checkpoints_is_left(root: Path, trained: tuple[Path, Outcome]) -> None:
    archived = archive(trained[0], root / "results/study", "s1", 0)
    shutil.rmtree(root / "reproduce/study/s1/deep/checkpoints")
    before = files(archived), files(root / "reproduce")
    assert dockctl("runs", "clean", "--root", root, "--yes").code == 0
    assert (files(archived), files(root / "reproduce")) == before


def test_a_run_whose_state_is_unknown_is_left(root: Path, trained: tuple[Path, Outcome]) -> None:
    archived = archive(trained[0], root / "results/study", "s1", 0)
    (archived / "provenance.json").write_text("{")
    before = files(archived)
    assert dockctl("runs", "clean", "--root", root, "--yes").code == 0
    assert files(archived) == before


def test_a_run_in_use_is_left(root: Path) -> None:
    before = files(root)
    with exclusive_lock(root / "s1/finished"), exclusive_lock(root / "s1/empty"):
        assert dockctl("runs", "clean", "--root", root, "--yes").code == 0
    assert files(root) == before


def test_older_checkpoints_are_left_where_the_newest_is_damaged(root: Path) -> None:
    (root / "s1/finished/checkpoints/last/learner.safetensors").write_bytes(b"")
    dockctl("runs", "clean", "--root", root, "--yes")
    assert (root / "s1/finished/checkpoints/last-1").is_dir()


def test_a_folder_without_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    listed = dockctl("runs")
    assert (listed.code, "dockctl train" in listed.out) == (0, True)
    assert json.loads(dockctl("runs", "--json", "-").out) == []
    assert dockctl("runs", "clean", "--yes").code == 0
    assert not list(tmp_path.iterdir())


def test_mistakes(root: Path) -> None:
    assert dockctl("runs", "--root", root / "gone").error_code == "not_found"
    assert dockctl("runs", "cleen", "--root", root).error_code == "unknown_name"
    before = files(root)
    assert dockctl("runs", "--root", root, "--yes").code == 2
    assert files(root) == before


@pytest.mark.parametrize("action", ["list", "clean"])
def test_paths_are_whole_in_a_narrow_terminal(
    action: str, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (root / "s1/finished").rename(root / "s1/finished-and-of-a-name-that-is-longer-than-the-terminal-is-wide")
    monkeypatch.setenv("COLUMNS", "50")
    outcome = dockctl("runs", action, "--root", root)
    assert "finished-and" in outcome.out
    assert "…" not in outcome.out


@pytest.mark.parametrize("width", [60, 80])
def test_long_names_fit_into_a_narrow_terminal(
    width: int, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change(root / "s1/finished", name="Ω" * 70, tags=["Ж" * 55])
    monkeypatch.setenv("COLUMNS", str(width))
    text = dockctl("runs", "--root", root).out
    assert max(map(len, text.splitlines())) <= width
    assert (text.count("Ω"), text.count("Ж")) == (70, 55)
