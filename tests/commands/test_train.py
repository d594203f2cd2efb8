"""`dockctl train`: the run folder, interrupting and resuming, errors."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from dockctl.agents.progress import Progress
from dockctl.drawing.scene import Scene
from dockctl.experiments.live import TrainingDisplay
from dockctl.runs.files import exclusive_lock
from dockctl.runs.tables import EPISODES, EVALUATIONS, TRAJECTORIES, UPDATES
from dockctl.scenarios.loader import load
from dockctl.scenarios.training import Training
from tests.commands.conftest import Outcome, dockctl, only_run, quick_train

EXAMPLES = Path(__file__).parents[2] / "examples"
Trained = tuple[Path, Outcome]
KINDS = ("pose", "validation")


def rows(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(path.read_text().splitlines()))


def test_the_run_folder_is_complete(trained: Trained) -> None:
    run, outcome = trained
    assert outcome.code == 0
    assert {path.name for path in run.iterdir()} >= {
        "scenario.yaml", "provenance.json", "scene.json", "episodes.csv", "updates.csv", "evaluations.csv",
        "timing.csv", "trajectories.csv", "checkpoints",
    }  # fmt: skip
    assert {path.name.split("-")[0] for path in (run / "checkpoints").iterdir()} == {"best", "last"}
    assert not [path for path in run.rglob("*") if path.suffix in (".pt", ".pkl", ".pickle", ".tmp")]
    facts = json.loads((run / "provenance.json").read_text())
    assert (facts["seed"], facts["stop_reason"]) == (3, "steps")
    assert facts["finished"] >= facts["started"]
    resolved = load(run / "scenario.yaml").scenario
    assert (resolved.name, resolved.training.seed, resolved.training.total_steps) == ("s1", 3, 300)
    assert Scene.from_json(json.loads((run / "scene.json").read_text())).polygons


def test_the_columns_are_the_documented_ones(trained: Trained) -> None:
    run, _ = trained
    terms = [f"reward_{name}" for name in ("collision", "final", "distance", "orientation", "speed")]
    ranges = [f"range_{sector}_m" for sector in range(1, 9)]
    for name, columns in {
        "episodes.csv": [*EPISODES, *terms],
        "updates.csv": [*UPDATES],
        "evaluations.csv": [*EVALUATIONS],
        "trajectories.csv": [*TRAJECTORIES, *ranges],
    }.items():
        assert list(rows(run / name)[0]) == columns, name


def test_rewards_by_term_add_up_and_trajectories_start_at_the_test_pose(trained: Trained) -> None:
    run, _ = trained
    for row in rows(run / "episodes.csv"):
        total = sum(float(value) for name, value in row.items() if name.startswith("reward_"))
        assert total == pytest.approx(float(row["return"]), rel=1e-4)
    first, *others = rows(run / "trajectories.csv")
    assert [float(first[name]) for name in ("x_m", "y_m", "heading_deg", "time_s")] == [20, 2, 160, 0]
    assert float(others[0]["time_s"]) == 0.5


def test_it_reports_the_result_and_the_next_command(trained: Trained) -> None:
    run, outcome = trained
    assert "300 steps" in outcome.out
    assert f"dockctl evaluate {run}" in outcome.out
    assert "\x1b" not in outcome.out


def test_the_same_seed_gives_the_same_bytes(trained: Trained, tmp_path: Path) -> None:
    assert quick_train(tmp_path, "s1", "--seed", 3, "--steps", 300).code == 0
    for name in ("episodes.csv", "updates.csv", "evaluations.csv", "trajectories.csv", "scenario.yaml"):
        assert (only_run(tmp_path) / name).read_bytes() == (trained[0] / name).read_bytes(), name


def test_interrupted_resumed_finished_and_extended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    show = TrainingDisplay.__call__

    def press_ctrl_c(self: TrainingDisplay, progress: Progress) -> None:
        show(self, progress)
        if progress.env_steps == 150:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(TrainingDisplay, "__call__", press_ctrl_c)
    interrupted = quick_train(tmp_path, "s1", "--steps", 200)
    run = only_run(tmp_path)
    assert interrupted.code == 130
    assert f"dockctl train --resume {run}" in interrupted.out
    assert json.loads((run / "provenance.json").read_text())["finished"] is None

    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    shorter = dockctl("train", "--resume", run, "--steps", 149)
    assert (shorter.code, shorter.error_code) == (2, "out_of_range")
    assert str(run) in shorter.err and "150" in shorter.err
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before

    resumed = dockctl("train", "--resume", run)
    assert resumed.code == 0
    assert "200 steps" in resumed.out
    facts = json.loads((run / "provenance.json").read_text())
    assert [again["env_steps"] for again in facts["resumed"]] == [150]

    for arguments in ((), ("--steps", 200)):
        outcome = dockctl("train", "--resume", run, *arguments)
        assert outcome.code == 2
        assert f"{run}: " in outcome.err
    extended = dockctl("train", "--resume", run, "--steps", 240)
    assert extended.code == 0
    evaluations = rows(run / "evaluations.csv")
    steps = {
        kind: [int(row["env_steps"]) for row in evaluations if row["start_kind"] == kind] for kind in KINDS
    }
    assert steps == {"pose": [100, 200, 240], "validation": [200] * 3 + [240] * 3}


SB3 = "training.algorithm={kind: sb3, %s}"
HUGE = ("--set", "training.replay_capacity=1000000000", "--steps", "1000000000")


@pytest.mark.parametrize(
    ("arguments", "place", "code", "suggestion"),
    [
        (["s1", "--set", "training.boat=3"], "training.boat", "unknown_key", "boats"),
        (["s1", "--set", "training.batch_size=-1"], "training.batch_size", "out_of_range", ""),
        (["s9"], "s9", "unknown_name", "s3"),
        (["s1", "--device", "abacus"], "'abacus'", "unavailable", ""),
        (["s1", "--device", "meta"], "'meta'", "unavailable", ""),
        (["s1", "--set", "actions={kind: continuous}"], "--set actions", "mismatch", ""),
        (["s1", "--set", "training.algorithm.kind=dqm"], "training.algorithm.kind", "unknown_name", "dqn"),
        (["s1", "--set", SB3 % "model: SAC"], "training.algorithm", "mismatch", ""),
        (["s1", "--set", SB3 % "model: DQNN"], "training.algorithm.model", "unknown_name", "DQN"),
        (["s1", "--set", SB3 % "model: PPO"], "training.algorithm.model", "invalid", ""),
        (["s1", "--set", SB3 % "policy: MlpPolice"], "training.algorithm", "unknown_name", "MlpPolicy"),
        (["s1", "--set", SB3 % "hyperparameters: {tao: 1}"], "training.algorithm", "unknown_key", "tau"),
        (["s1", "--set", SB3 % "hyperparameters: {gamma: 1}"], "training.gamma", "invalid", ""),
        (["s1", "--set", SB3 % "hyperparameters: {tau: [1]}"], "training.algorithm", "wrong_type", ""),
        (["s1", *HUGE], "training.replay_capacity", "unavailable", ""),
        ([""], "", "not_readable", ""),
        (["--resume", "nowhere"], "nowhere", "not_found", ""),
        (["--resume", "."], ".", "not_found", ""),
    ],
)
def test_bad_input_gives_one_error_and_nothing_is_written(
    arguments: list[str],
    place: str,
    code: str,
    suggestion: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("train", *arguments)
    assert outcome.code == 2
    assert outcome.error is not None
    assert (outcome.error.code, outcome.error.suggestion) == (code, suggestion)
    assert place in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_an_output_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    outcome = quick_train(tmp_path / "file", "s1")
    assert outcome.code == 2
    assert str(tmp_path / "file") in outcome.err


def test_a_run_in_use_is_not_resumed(trained: Trained) -> None:
    with exclusive_lock(trained[0]):
        outcome = dockctl("train", "--resume", trained[0], "--steps", 400)
    assert outcome.code == 2
    assert outcome.err.startswith(f"error: {trained[0]}:")


def test_a_training_locks_its_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    outcomes: list[Outcome] = []

    def resume(*_: object) -> None:
        if not outcomes:
            outcomes.append(dockctl("train", "--resume", only_run(tmp_path)))

    monkeypatch.setattr(TrainingDisplay, "__call__", resume)
    assert quick_train(tmp_path, "s1", "--steps", 20).code == 0
    assert outcomes[0].code == 2
    assert outcomes[0].err.startswith(f"error: {only_run(tmp_path)}:")


@pytest.mark.parametrize(
    "arguments",
    [
        ("evaluate", "--ckpt"),
        ("evaluate", "--ckpt", "s1", "--csv"),
        ("train", "--resume"),
        ("plot",),
        ("reproduce", "--study"),
        ("train", "s1", "--steps", "1", "--out"),
    ],
)
def test_a_name_that_is_too_long_is_an_error(
    arguments: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl(*arguments, "x" * 300)
    assert outcome.code == 2
    assert outcome.err.count("error:") == 1


def test_a_resumed_run_keeps_its_own_settings(trained: Trained) -> None:
    outcome = dockctl("train", "s2", "--resume", trained[0], "--seed", 0, "--out", "x")
    assert outcome.code == 2
    assert all(option in outcome.err for option in ("SCENARIO", "--seed", "--out"))


@pytest.mark.parametrize("broken", ["policy.json", "learner.safetensors"])
def test_a_run_without_an_intact_checkpoint_is_not_resumed(
    trained: Trained, tmp_path: Path, broken: str
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained[0], run)
    files = sorted(run.glob(f"checkpoints/last*/{broken}"))
    assert len(files) == 3
    for file in files:
        file.write_bytes(file.read_bytes()[:30])
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    outcome = dockctl("train", "--resume", run, "--steps", 1000)
    assert (outcome.code, outcome.error_code) == (2, "not_readable")
    assert all(str(file.parent) in outcome.err for file in files)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_plugin_travels_with_the_run(tmp_path: Path) -> None:
    plugin = tmp_path / "mine.py"
    plugin.write_text(
        "from dockctl.rewards.terms import reward_term\n\n\n"
        "@reward_term('steady', kind='dense', source='mine')\n"
        "def steady(status, *, unit_m: float = 2.0):\n    return status.distance_m / unit_m\n"
    )
    outcome = quick_train(
        tmp_path / "runs", "s1", "--steps", 60, "--plugin", plugin, "--set", "reward.terms.steady=-3"
    )
    assert outcome.code == 0
    run = only_run(tmp_path / "runs")
    plugin.unlink()
    assert load(run / "scenario.yaml").scenario.plugins == (str(run / "plugins" / "00-mine.py"),)
    assert list(json.loads((run / "provenance.json").read_text())["plugins"]) == ["plugins/00-mine.py"]
    assert dockctl("evaluate", "--ckpt", run, "--episodes", 1).code == 0
    assert dockctl("train", "--resume", run, "--steps", 80).code == 0
    assert (run / "scenario.yaml").read_text().count("plugins/00-mine.py") == 1


def test_a_mesh_harbor_travels_with_the_run(tmp_path: Path) -> None:
    shutil.copytree(EXAMPLES / "custom-harbor", tmp_path / "harbor")
    outcome = quick_train(tmp_path / "runs", tmp_path / "harbor" / "s1-pontoon.yaml", "--steps", 60)
    assert outcome.code == 0, outcome.err
    shutil.rmtree(tmp_path / "harbor")
    run = only_run(tmp_path / "runs").rename(tmp_path / "moved")
    (mesh,) = load(run / "scenario.yaml").scenario.harbor.meshes
    assert mesh.path == str(run / "meshes" / "00-pontoon.obj")
    hashes = json.loads((run / "provenance.json").read_text())["meshes"]
    digest = hashlib.sha256((EXAMPLES / "custom-harbor" / "pontoon.obj").read_bytes()).hexdigest()
    assert hashes == {"meshes/00-pontoon.obj": digest}
    assert dockctl("evaluate", "--ckpt", run, "--episodes", 1).code == 0
    assert dockctl("train", "--resume", run, "--steps", 80).code == 0
    assert "path: meshes/00-pontoon.obj\n" in (run / "scenario.yaml").read_text()


def progress(**changes: Any) -> Progress:
    return Progress(env_steps=5_000, episodes=2, outcomes={"docked": 1, "collision": 1}, **changes)


def numbers(line: str) -> list[str]:
    return re.findall(r"-?\d[\d,:]*\b", line)


def test_a_terminal_gets_a_panel() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=100)
    with TrainingDisplay(Training(), "s1", console) as display:
        display(
            progress(
                loss=0.25,
                best=[90, 100, 300.0],
                evaluated_at=4_000,
                evaluation_docked=1,
                evaluation_episodes=1,
            )
        )
    assert isinstance(console.file, io.StringIO)
    text = console.file.getvalue()
    for words in (
        "s1",
        "5,000 of 500,000",
        "1 collision, 1 docked",
        "0.25",
        "90 of 100",
        "300",
        "Ctrl-C",
    ):
        assert words in text, words


def test_the_last_panel_shows_the_policy_that_the_end_selects() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=100)
    best, evaluation = [90, 100, -12_345.0], {"evaluation_docked": 1, "evaluation_episodes": 1}
    with TrainingDisplay(Training(), "s1", console) as display:
        display(progress())
        display.finish(progress(best=best, evaluated_at=1_000_000, **evaluation))
    assert isinstance(console.file, io.StringIO)
    before, _, panel = console.file.getvalue().rpartition("╭")
    (line,) = (line for line in before.splitlines() if "1,000,000" in line)
    assert numbers(line)[-6:] == ["1,000,000", "1", "1", "90", "100", "-12,345"]
    assert "90 of 100" not in before.partition(line)[0]
    assert "90 of 100" in panel


def test_without_a_terminal_there_are_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = iter(range(0, 100, 10))
    monkeypatch.setattr("dockctl.experiments.live.time.monotonic", lambda: next(seconds))
    console = Console(file=io.StringIO(), width=80)
    with TrainingDisplay(Training(), "s1", console) as display:
        first = progress()
        display(first)
        first.env_steps += 2_000
        display(first)
    assert isinstance(console.file, io.StringIO)
    (line,) = console.file.getvalue().splitlines()
    assert numbers(line)[:7] == ["7,000", "500,000", "200", "0:00", "41:05", "0", "2"]


@pytest.mark.parametrize(
    ("model", "actions"),
    [
        ("DQN", "grid"),
        pytest.param("SAC", "continuous", marks=pytest.mark.thorough),
        pytest.param("TD3", "continuous", marks=pytest.mark.thorough),
    ],
)
@pytest.mark.usefixtures("one_figure")
def test_stable_baselines_leaves_a_normal_run_folder(model: str, actions: str, tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    algorithm = f"training.algorithm={{kind: sb3, model: {model}, action_noise: 0.1}}"
    settings = ("--set", algorithm, "--set", f"actions.kind={actions}", "--steps", 120)
    outcome = quick_train(tmp_path, "s1", *settings)
    assert outcome.code == 0, outcome.err
    run = only_run(tmp_path)
    assert {path.name.split("-")[0] for path in (run / "checkpoints").iterdir()} == {"best", "last"}
    assert not [path for path in run.rglob("*") if path.suffix in (".pt", ".pkl", ".pickle", ".zip")]
    assert {row["update"] for row in rows(run / "updates.csv")} == {str(n) for n in range(1, 51)}
    assert rows(run / "trajectories.csv")
    commands: list[tuple[object, ...]] = [("evaluate", "--ckpt", run, "--episodes", 1)]
    others = (
        ("map", "--ckpt", run, "--reach-m", 1, "--step-m", 1, "--headings", 0),
        ("latency", "--ckpt", run, "--decisions", 10),
        ("plot", run),
        ("train", "--resume", run, "--steps", 160),
    )
    for command in [*commands, *(others if model == "SAC" else ())]:
        outcome = dockctl(*command)
        assert outcome.code == 0, (command, outcome.err)


def test_without_the_extra_the_error_explains_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dockctl.agents.algorithms.find_spec", lambda name: None)
    outcome = quick_train(tmp_path / "runs", "s1", "--set", "training.algorithm={kind: sb3}")
    assert (outcome.code, outcome.error_code) == (2, "unavailable")
    assert "dockctl[sb3]" in outcome.err
    assert not (tmp_path / "runs").exists()
