"""A plugin that fails late in a training: one error, its exit code, and a run that can be resumed."""

from __future__ import annotations

import json
from pathlib import Path

from tests.commands.conftest import dockctl, only_run, quick_train

LATE = """
import numpy as np
from dockctl.rewards.terms import reward_term

calls = []

@reward_term("late", kind="dense")
def late(status):
    calls.append(1)
    return {value} if len(calls) == {after} else np.zeros(len(status.phase))
"""


def late_term(path: Path, value: str, after: int = 120) -> tuple[object, ...]:
    path.write_text(LATE.format(value=value, after=after))
    return ("s1", "--steps", 400, "--set", "reward.terms.late=-1", "--plugin", path)


def test_numbers_that_are_not_finite_have_their_own_exit_code(tmp_path: Path) -> None:
    arguments = late_term(tmp_path / "late.py", "status.distance_m * np.nan")
    outcome = quick_train(tmp_path / "runs", *arguments)
    assert (outcome.code, outcome.error_code) == (3, "diverged")
    assert "'late'" in outcome.err
    run = only_run(tmp_path / "runs")
    assert json.loads((run / "provenance.json").read_text())["stop_reason"] == "diverged"
    steps = json.loads((run / "checkpoints/last/policy.json").read_text())["env_steps"]
    assert steps == 100


def test_a_training_may_continue(tmp_path: Path) -> None:
    arguments = late_term(tmp_path / "late.py", "status.distance_m * np.nan")
    outcome = quick_train(tmp_path / "runs", *arguments, "--on-divergence", "continue")
    assert outcome.code == 0
    assert "'late'" in outcome.out


def test_a_training_without_a_finite_policy_does_not_suggest_to_evaluate_it(tmp_path: Path) -> None:
    changed = ("learning_rate=1000", "huber_delta=null", "gradient_clip=null")
    overrides = [text for change in changed for text in ("--set", f"training.{change}")]
    outcome = quick_train(tmp_path / "runs", "s1", "--steps", 400, *overrides, "--on-divergence", "continue")
    assert outcome.code == 0
    assert not [*only_run(tmp_path / "runs").glob("checkpoints/*")]
    assert "dockctl plot" in outcome.out
    assert "dockctl evaluate" not in outcome.out


def test_an_unknown_reaction_is_an_error(tmp_path: Path) -> None:
    outcome = quick_train(tmp_path / "runs", "s1", "--on-divergence", "explode")
    assert outcome.code == 2
    assert not (tmp_path / "runs").exists()


def test_a_plugin_that_raises_ends_the_training_with_its_line_and_the_state_is_saved(tmp_path: Path) -> None:
    path = tmp_path / "late.py"
    outcome = quick_train(tmp_path / "runs", *late_term(path, "1 / 0"))
    assert (outcome.code, outcome.error_code) == (2, "plugin")
    (line,) = [i for i, text in enumerate(path.read_text().splitlines(), start=1) if "1 / 0" in text]
    assert f"({path}:{line})" in outcome.err
    run = only_run(tmp_path / "runs")
    saved = json.loads((run / "checkpoints/last/policy.json").read_text())["env_steps"]
    assert saved > 100 and saved % 100  # later than the checkpoint of the interval
    assert dockctl("train", "--resume", run).code == 0  # the plugin fails only once
