"""``dockctl export``: selection, checkpoint folder, model card and errors. The policies are untrained."""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dockctl.agents.checkpoint import load_pair, load_policy, save_policy
from dockctl.errors import DockctlError
from dockctl.evaluation.policies import CheckpointPolicy
from dockctl.experiments import export
from dockctl.runs.results import write_measurement
from tests.commands.conftest import Outcome, dockctl, forget_interface

MakeRun = Callable[..., Path]


@pytest.fixture
def runs(
    trained: tuple[Path, Outcome], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Path]:
    """Return a function that makes an evaluated run with the given outcomes."""
    docking: set[int] = set()

    def play(policy: CheckpointPolicy, loaded: object) -> list[object]:
        class One:
            docked = policy.card.seed in docking
            outcome = "docked" if docked else "timeout"
            phase, collided_with = 1, ""
            row = staticmethod(lambda: {"outcome": "docked", "phase": 1, "clearance_m": 1.5})
            start = type("Start", (), {"eta": (20.0, -2.0, -2.8)})

        return [One()]

    monkeypatch.setattr(export, "training_episodes", play)

    def make(seed: int, poses: str, random: str, *, docks: bool = True) -> Path:
        run = tmp_path / f"run{seed}"
        shutil.copytree(trained[0], run)
        card = run / "checkpoints" / "best" / "policy.json"
        card.write_text(json.dumps({**json.loads(card.read_text()), "seed": seed, "format": 1}))
        assert dockctl("evaluate", "--ckpt", run, "--episodes", 3).code == 0
        head, *rows = (run / "evaluation.csv").read_text().splitlines()
        at, outcomes = head.split(",").index("outcome"), [*poses, *random]
        cells = [row.split(",") for row in rows]
        for row, outcome in zip(cells, outcomes, strict=True):
            row[at] = {"+": "docked", "-": "collision"}[outcome]
        lines = [head, *(",".join(row) for row in cells)]
        facts = json.loads((run / "evaluation.json").read_text())
        write_measurement(run / "evaluation", "\n".join(lines) + "\n", facts)
        if docks:
            docking.add(seed)
        return run

    return make


def test_best_policy_that_docks_from_its_training_poses_is_exported(
    runs: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = [
        runs(0, "-", "+++"),
        runs(1, "+", "++-"),
        runs(2, "+", "+++", docks=False),
        runs(4, "+", "++-"),
    ]
    forget_interface(given[1])
    outcome = dockctl("export", *given, "--name", "mine", "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    assert str(given[2]) in outcome.err and "(20, −2, 199.57°)" in outcome.err
    _, card = load_policy(tmp_path / "out" / "mine")
    assert (card.seed, card.interface is not None) == (1, True)
    shipped = (tmp_path / "out" / "mine" / "policy.safetensors").read_bytes()
    assert shipped == (given[1] / "checkpoints" / "best" / "policy.safetensors").read_bytes()
    text = (tmp_path / "out" / "mine" / "card.md").read_text()
    assert "| `s1` | training poses | 1 of 1 | 100.0% |" in text
    assert "| `s1` | random starts | 2 of 3 | 66.7% |" in text
    assert "1 of 3 failed: 1 collision" in text
    with (given[1] / "evaluation.csv").open() as file:
        failed = [row for row in csv.DictReader(file) if row["outcome"] == "collision"]
    headings = [float(heading) for heading in re.findall(r"([\d.]+)°\)", text)]
    assert headings == [pytest.approx(float(row["heading_deg"]) % 360, abs=0.01) for row in failed]
    assert "best of 4 runs" in text
    monkeypatch.chdir(tmp_path / "out" / "mine")
    (command,) = re.findall(r"^```sh\n(.*?)^```", text, re.M | re.S)
    assert [dockctl(*line.split()[1:], "--episodes", 0).code for line in command.splitlines()] == [0]
    assert {path.name for path in Path().iterdir()} == {*export.CHECKPOINT}


def test_the_card_names_conditions_and_parts_of_the_training(runs: MakeRun, tmp_path: Path) -> None:
    run = runs(0, "+", "+++")
    text = (run / "scenario.yaml").read_text()
    for before, after in (
        ("  conditions: {}", "  conditions: {current: {speed_mps: 0.1, direction_deg: 0}}"),
        ("  ensemble: null", "  ensemble: {networks: 2, every_steps: 100, restarts: 2}"),
    ):
        assert text.count(f"\n{before}\n") == 1
        text = text.replace(f"\n{before}\n", f"\n{after}\n")
    (run / "scenario.yaml").write_text(text)
    assert dockctl("export", run, "--name", "mine", "--out", tmp_path / "out").code == 0
    card = (tmp_path / "out" / "mine" / "card.md").read_text()
    assert "an ensemble of 2, 100 steps apart, from each of 3 parts of the training |" in card
    assert "| training data | simulation only; `current` from `training.conditions` |" in card


def test_a_note_tells_when_the_name_is_that_of_a_shipped_policy(runs: MakeRun, tmp_path: Path) -> None:
    given = runs(0, "+", "+++")
    for name, noted in (("s1", True), ("mine", False)):
        outcome = dockctl("export", given, "--name", name, "--out", tmp_path / "out")
        assert outcome.code == 0, outcome.err
        assert (str(tmp_path / "out" / name) in outcome.err) == noted


def test_the_policy_that_was_measured_is_exported(
    runs: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not the one by which a training that goes on replaces it in the meantime."""
    run = runs(1, "+", "+++")
    best = run / "checkpoints" / "best"
    measured, tensors = (best / "policy.safetensors").read_bytes(), load_pair(best / "policy.json")[0]
    play = export.training_episodes

    def play_and_train(policy: CheckpointPolicy, loaded: Any) -> Any:
        save_policy(best, {name: 2 * array for name, array in tensors.items()}, policy.card)
        return play(policy, loaded)

    monkeypatch.setattr(export, "training_episodes", play_and_train)
    assert dockctl("export", run, "--name", "mine", "--out", tmp_path / "out").code == 0
    assert (tmp_path / "out" / "mine" / "policy.safetensors").read_bytes() == measured


@pytest.mark.thorough
@pytest.mark.slow
def test_measurements_of_another_policy_are_not_in_the_card(runs: MakeRun, tmp_path: Path) -> None:
    run = runs(1, "+", "+++")
    assert dockctl("evaluate", "--ckpt", run, "--scenario", "s2", "--episodes", 0).code == 0
    assert dockctl("map", "--ckpt", run, "--reach-m", 0, "--headings", "0").code == 0
    assert dockctl("latency", "--ckpt", run, "--decisions", 10).code == 0

    def card() -> str:
        assert dockctl("export", run, "--name", "mine", "--out", tmp_path / "out").code == 0
        return (tmp_path / "out" / "mine" / "card.md").read_text()

    passages = ("| `s2` |", "free starts within", "A decision takes")
    assert [words in card() for words in passages] == [True, True, True]
    for name in ("evaluation-s2.json", "map.json", "figures/latency.json"):
        facts = json.loads((run / name).read_text())
        (run / name).write_text(json.dumps({**facts, "policy": {"sha256": "0" * 64}}))
    assert [words in card() for words in passages] == [False, False, False]


def test_candidate_without_random_starts_has_no_rate(runs: MakeRun, tmp_path: Path) -> None:
    given = [runs(1, "+", "+++"), runs(2, "+", "+++")]
    assert dockctl("evaluate", "--ckpt", given[1], "--episodes", 0).code == 0
    outcome = dockctl("export", *given, "--name", "mine", "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    assert "100% (seed 1), - (seed 2)" in (tmp_path / "out" / "mine" / "card.md").read_text()


def test_only_an_earlier_checkpoint_is_replaced(runs: MakeRun, tmp_path: Path) -> None:
    run = runs(1, "+", "+++")
    for _ in range(2):
        assert dockctl("export", run, "--out", tmp_path, "--name", "mine").code == 0
    (tmp_path / "all" / "run1").mkdir(parents=True)
    for folder in (run, tmp_path / "all", run / "checkpoints" / "best"):
        before = sorted(path.name for path in folder.iterdir())
        outcome = dockctl("export", run, "--out", folder.parent, "--name", folder.name)
        assert outcome.code == 2
        assert outcome.error is not None and str(outcome.error).startswith(f"{folder}: ")
        assert sorted(path.name for path in folder.iterdir()) == before


def test_errors(runs: MakeRun, trained: tuple[Path, Outcome], tmp_path: Path) -> None:
    run = runs(5, "+", "+++", docks=False)
    out = tmp_path / "out"

    def code_of(*paths: Path, name: str | None = None) -> str:
        with pytest.raises(DockctlError) as caught:
            export.export_checkpoint(paths, name, out)
        assert not out.exists()
        return caught.value.code

    assert code_of(run) == "invalid"  # no policy docks from its training poses
    assert code_of(run, name="../up") == "invalid"
    assert code_of(tmp_path) == "not_found"
    result = json.loads((run / "evaluation.json").read_text())
    result["policy"]["sha256"] = "0" * 64
    (run / "evaluation.json").write_text(json.dumps(result))
    assert code_of(run) == "mismatch"
    (run / "evaluation.json").unlink()
    assert code_of(run) == "not_found"
    assert dockctl("evaluate", "--ckpt", run, "--episodes", 1).code == 0
    table = (run / "evaluation.csv").read_bytes()
    assert dockctl("evaluate", "--ckpt", run, "--episodes", 2).code == 0
    (run / "evaluation.csv").write_bytes(table)  # of another evaluation
    assert code_of(run) == "mismatch"
    outcome = dockctl("export", run, "--out", out)
    assert (outcome.code, str(run) in outcome.err) == (2, True)
