"""``dockctl evaluate --record``: a recording is read like a run, and poses are checked."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.runs.reader import read_run
from dockctl.scenarios.base import Pose
from tests.commands.conftest import Outcome, dockctl


@pytest.mark.slow
def test_a_recording_is_stored_in_the_run_and_plotted_like_a_run(run: Path, tmp_path: Path) -> None:
    outcome = dockctl("evaluate", run, "--scenario", "s2", "--pose", "20,2,160", "--record")
    assert outcome.code == 0, outcome.err
    assert "20, 2, 160" in outcome.out
    assert not (run / "evaluation-s2.json").exists()  # not an evaluation from the poses of the scenario
    recorded = read_run(run / "transfer" / "s2")
    assert (recorded.scenario, recorded.tests) == ("s2", (Pose(x_m=20, y_m=2, heading_deg=160),))
    assert recorded.trajectories is not None
    first = recorded.trajectories.iloc[0]
    assert (first["x_m"], first["y_m"], first["heading_deg"]) == (20, 2, 160)
    assert (recorded.policy, recorded.missing) == ("the recorded policy", [])
    assert recorded.caption == "scenario s2, policy trained on s1, seed 3"
    plotted = dockctl("plot", run / "transfer" / "s2")
    assert (plotted.code, plotted.err) == (0, "")
    assert (run / "transfer" / "s2" / "figures" / "docking-poses.png").is_file()


def test_without_a_pose_it_records_the_test_poses_as_the_training_did(run: Path, tmp_path: Path) -> None:
    assert dockctl("evaluate", run, "--record", tmp_path / "here").code == 0
    recorded = (tmp_path / "here" / "trajectories.csv").read_text()
    assert recorded == (run / "trajectories.csv").read_text()


def test_only_an_earlier_recording_is_replaced(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    for _ in range(2):
        assert dockctl("evaluate", run, "--episodes", 0, "--record", ".").code == 0
        monkeypatch.chdir(here)  # it is a new folder
    (here / "mine.txt").write_text("mine")
    for folder in (here, run, Path()):
        before = sorted(path.name for path in folder.iterdir())
        outcome = dockctl("evaluate", run, "--episodes", 0, "--record", folder)
        assert outcome.code == 2
        assert outcome.error is not None and str(outcome.error).startswith(f"{folder}: ")
        assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.thorough
def test_a_second_policy_does_not_replace_the_recording_of_the_first(run: Path, tmp_path: Path) -> None:
    def recorded(ckpt: object, *out: object) -> Outcome:
        return dockctl("evaluate", ckpt, "--pose", "20,2,160", "--record", *out)

    best, last, here = run, run / "checkpoints" / "last", tmp_path / "here"
    assert recorded(best).code == recorded(last).code == 0
    assert (run / "transfer" / "s1" / "recording.json").is_file()
    assert (run / "last" / "transfer" / "s1" / "recording.json").is_file()
    assert recorded(best, here).code == recorded(best, here).code == 0
    before = (here / "recording.json").read_bytes()
    refused = recorded("s1", here)
    assert (refused.code, refused.error_code) == (2, "mismatch")
    assert (here / "recording.json").read_bytes() == before


@pytest.mark.parametrize(
    ("pose", "code"),
    [
        ("20,2", "wrong_type"),
        ("36,4,180", "invalid"),  # blocked
        ("90,0,0", "invalid"),  # outside of the basin
        ("1e9,0,0", "out_of_range"),
    ],
)
def test_a_pose_that_cannot_be_used(run: Path, pose: str, code: str) -> None:
    outcome = dockctl("evaluate", run, "--pose", pose, "--record")
    assert (outcome.code, outcome.error_code) == (2, code)
    assert str(outcome.error).startswith("--pose")
    assert not (run / "transfer").exists()


@pytest.mark.thorough
def test_figures_of_a_recording_stay_until_it_changes(run: Path, tmp_path: Path) -> None:
    def record(pose: str) -> None:
        assert dockctl("evaluate", run, "--pose", pose, "--record", tmp_path / "here").code == 0

    record("20,2,160")
    assert dockctl("plot", tmp_path / "here").code == 0
    figure = tmp_path / "here" / "figures" / "docking-poses.png"
    record("20,2,160")
    assert figure.is_file()
    record("21,2,160")
    assert not figure.exists()
