"""``dockctl latency``: what is timed and written. No test asserts a time."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from dockctl.analysis.latency import REQUIRED
from tests.commands.conftest import Outcome, dockctl, forget_interface

ENDS = ("png", "svg", "csv", "json")


@pytest.mark.thorough
@pytest.mark.slow
def test_without_a_run_a_shipped_policy_is_timed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("latency", "--decisions", 10, "--scenario", "s1")
    assert outcome.code == 0
    folder = tmp_path / "figures" / "latency"
    (table,) = folder.glob("latency-s1-*.csv")
    assert {path.name for path in folder.iterdir()} == {f"{table.stem}.{end}" for end in ENDS}
    samples = pd.read_csv(table)
    assert list(samples) == ["decision", *REQUIRED]
    assert len(samples) >= 10
    assert (samples[["scan_ms", "state_ms", "forward_ms"]].sum(axis=1)).to_numpy() == pytest.approx(
        samples["decision_ms"].to_numpy(), rel=1e-4
    )
    facts = json.loads(table.with_suffix(".json").read_text())
    assert facts["milliseconds"]["Whole decision"]["max"] == pytest.approx(
        samples["decision_ms"].max(), rel=1e-4
    )
    assert facts["control_period_ms"] == 500.0


@pytest.mark.slow
def test_a_trained_policy_is_timed_on_its_scenario(trained: tuple[Path, Outcome], tmp_path: Path) -> None:
    outcome = dockctl("latency", "--ckpt", trained[0], "--decisions", 10, "--out", tmp_path)
    assert outcome.code == 0
    assert {path.name for path in tmp_path.iterdir()} == {
        f"latency-s1-{trained[0].name}.{end}" for end in ENDS
    }
    facts = json.loads((tmp_path / f"latency-s1-{trained[0].name}.json").read_text())
    assert (facts["policy"]["scenario"], facts["policy"]["seed"]) == ("s1", 3)


@pytest.mark.thorough
@pytest.mark.slow
def test_the_latest_run_is_timed_and_files_name_another_scenario(
    trained: tuple[Path, Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "runs" / "s1" / "20250101-000000-seed3"
    shutil.copytree(trained[0], run, ignore=shutil.ignore_patterns("figures"))
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("latency", "--scenario", "s2", "--decisions", 10)
    assert outcome.code == 0
    files = {path.name for path in (run / "figures").iterdir()}
    assert files == {f"latency-s2.{end}" for end in ENDS}


def test_another_observation_size_is_an_error(trained: tuple[Path, Outcome], tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained[0], run)
    forget_interface(run)
    outcome = dockctl("latency", "--ckpt", run, "--scenario", "s3", "--out", tmp_path / "out")
    assert outcome.code == 2
    assert outcome.error is not None and str(outcome.error).partition(": ")[0].endswith("policy.json")
    assert not (tmp_path / "out").exists()


def test_a_missing_checkpoint_is_an_error(tmp_path: Path) -> None:
    outcome = dockctl("latency", "--ckpt", tmp_path / "nothing")
    assert outcome.code == 2
    assert outcome.error is not None and str(tmp_path / "nothing") in str(outcome.error)
