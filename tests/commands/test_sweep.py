"""``dockctl train --seeds``: every combination is trained, evaluated and summarized, and not repeated."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import pytest
from rich.console import Console

from dockctl.experiments.runner import Ending
from dockctl.experiments.study import Job
from tests.commands.conftest import QUICK, dockctl, only_run, quick_train


@pytest.mark.slow
@pytest.mark.usefixtures("in_process")
def test_a_sweep_trains_every_combination_and_is_resumable(tmp_path: Path) -> None:
    settings = [word for setting in QUICK for word in ("--set", setting)]
    command = (
        "train", "s1", "--seeds", 1, "--jobs", 2, "--steps", 120, "--tag", "quick", "--out", tmp_path,
        *settings, "--set", "training.gamma=0.9,0.99",
    )  # fmt: skip
    first = dockctl(*command)
    assert first.code == 0, first.out + first.err
    runs = sorted((tmp_path / "s1").glob("*/s1/*-seed0"))
    assert [run.parent.parent.name for run in runs] == ["gamma-0.9", "gamma-0.99"]
    for run in runs:
        assert json.loads((run / "provenance.json").read_text())["tags"] == ["quick"]
        assert (run / "evaluation.json").is_file()
        assert run.parent.parent.name in first.out
    again = dockctl(*command, "--json", tmp_path / "sweep.json")
    assert again.code == 0
    rows = json.loads((tmp_path / "sweep.json").read_text())
    assert [(row["combination"], row["runs"]) for row in rows] == [("gamma-0.9", 1), ("gamma-0.99", 1)]
    for row, run in zip(rows, runs, strict=True):
        evaluated = json.loads((run / "evaluation.json").read_text())["random_starts"]
        assert row["starts"]["random"] == {key: [evaluated[key]] for key in ("docked", "episodes")}
    assert sorted((tmp_path / "s1").glob("*/s1/*-seed0")) == runs


def test_name_and_tags_are_in_the_provenance(tmp_path: Path) -> None:
    given = ("--steps", 60, "--name", "my run", "--tag", "a", "--tag", "b")
    assert quick_train(tmp_path, "s1", *given).code == 0
    facts = json.loads((only_run(tmp_path) / "provenance.json").read_text())
    assert (facts["name"], facts["tags"]) == ("my run", ["a", "b"])


@pytest.mark.parametrize("wrong", ["--seed=1", "--set=training.seed=1", "--set=training.seed=1,2"])
def test_seeds_are_given_by_their_number(tmp_path: Path, wrong: str) -> None:
    outcome = dockctl("train", "s1", "--seeds", 2, wrong, "--out", tmp_path)
    assert outcome.code == 2
    assert "seed" in outcome.err
    assert "--seeds N" in outcome.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", [("--jobs", 2), ("--json", "-")])
def test_one_run_has_no_options_of_a_sweep(tmp_path: Path, option: tuple[str, object]) -> None:
    outcome = dockctl("train", "s1", *option, "--out", tmp_path)
    assert outcome.code == 2
    assert option[0] in outcome.err
    assert "--seeds" in outcome.err
    assert not list(tmp_path.iterdir())


def test_every_training_of_a_sweep_has_the_plugins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plugin = Path("examples/local-term/gentle.py").resolve()
    given: list[Job] = []

    def run_jobs(console: Console, jobs: Sequence[Job], workers: int | None) -> tuple[Ending, list[Job]]:
        given.extend(jobs)
        return "done", []

    monkeypatch.setattr("dockctl.experiments.sweep.run_jobs", run_jobs)
    command = ("train", "s1", "--seeds", 2, "--out", tmp_path, "--plugin", plugin)
    assert dockctl(*command, "--set", "reward.terms.gentle_turns=-1,-2").code == 0
    assert len(given) == 4
    for job in given:
        stage = job.training()
        assert stage
        assert ("--plugin", str(plugin)) in pairwise(stage.arguments)
        assert "gentle_turns" in {term.term for term in job.scenario.reward.terms}
