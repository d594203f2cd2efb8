"""``training.conditions``: they hold in training alone, and their faults are located."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import InputError
from dockctl.experiments.dry_run import dry_run
from dockctl.runs.reader import read_table
from dockctl.scenarios.loader import dump, load
from dockctl.sim.checks import load_checked, notes
from tests.commands.conftest import dockctl, quick_train

TEXT = """extends: s1
conditions:
  current: {speed_mps: 0.05, direction_deg: 0, variation_mps: 0.01}
  wind: {speed_mps: 2, direction_deg: 90}
training:
  conditions:
    current: {speed_mps: [0.2, 0.3], direction_deg: 180}
    navigation: {position_m: 0.5}
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT)
    return path


def test_they_replace_those_of_the_same_name_and_add_others(file: Path) -> None:
    own = load(file).scenario
    trained = own.in_training().conditions
    assert list(own.conditions) == ["current", "wind"]
    assert list(trained) == ["current", "wind", "navigation"]
    assert trained["current"] == own.training.conditions["current"] != own.conditions["current"]
    assert trained["wind"] == own.conditions["wind"]


def test_the_training_environment_draws_from_them_and_the_evaluation_does_not(file: Path) -> None:
    own = load(file).scenario
    for scenario, least, most, error in ((own.in_training(), 0.2, 0.3, 0.5), (own, 0.0, 0.15, 0.0)):
        _, info = DockingVectorEnv(scenario, 16).reset(seed=3)
        speed = np.hypot(*info["current"].T)
        assert ((speed >= least) & (speed <= most)).all(), speed
        measured = info.get("measured_pose", info["pose"])
        assert np.std(measured[:, :2] - info["pose"][:, :2]) == pytest.approx(error, rel=0.5)


def test_they_survive_writing_and_an_inherited_one_is_removed_by_null(file: Path) -> None:
    own = load(file).scenario
    (file.parent / "again.yaml").write_text(dump(own))
    assert load(file.parent / "again.yaml").scenario == own
    (file.parent / "other.yaml").write_text(
        "extends: mine.yaml\ntraining: {conditions: {current: {speed_mps: 0.1}, navigation: null}}\n"
    )
    (current,) = load(file.parent / "other.yaml").scenario.training.conditions.values()
    assert current.model_dump()["speed_mps"] == 0.1
    assert current.model_dump()["direction_deg"] == 180


@pytest.mark.parametrize(
    ("text", "field", "column"),
    [
        ("curent: {speed_mps: 1}", "training.conditions.curent", 25),
        ("current: {speed_mps: -1, direction_deg: 0}", "training.conditions.current.speed_mps", 46),
        ("current: {speed_mps: 0.1}", "training.conditions.current.direction_deg", 25),
        ("shallow_water: {depth_m: 0.1}", "training.conditions.shallow_water.depth_m", 50),
        ("lidar_faults: {sectors: [9]}", "training.conditions.lidar_faults.sectors", 49),
        ("wind: {speed_mps: 100, direction_deg: 90, lateral_area_m2: 20000}", "training.conditions", 24),
    ],
)
def test_a_problem_has_its_place(tmp_path: Path, text: str, field: str, column: int) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: s1\ntraining: {{conditions: {{{text}}}}}\n")
    with pytest.raises(InputError) as caught:
        dry_run(load(file))
    (problem,) = caught.value.problems
    assert (problem.line, problem.column, problem.field) == (2, column, field), problem


def test_a_note_says_that_they_exceed_the_control_authority(file: Path) -> None:
    _, note = notes(load_checked(file))
    assert "mine.yaml:7:26: training.conditions.current.speed_mps: " in note
    assert "current of 0.3 m/s" in note


def test_a_note_says_that_they_exceed_it_together_with_the_others(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        "extends: s1\nconditions: {wind: {speed_mps: 4, direction_deg: 90}}\n"
        "training: {conditions: {current: {speed_mps: 0.05, direction_deg: 180}}}\n"
    )
    (note,) = notes(load_checked(file))
    scenario = load(file).scenario
    wind, current = scenario.with_training_conditions().conditions.values()
    force, other = wind.side_force_n(scenario.vessel), current.side_force_n(scenario.vessel)
    assert max(force, other) < scenario.vessel.max_side_n < force + other
    assert "mine.yaml:3:24: training.conditions: together they take up to " in note
    assert f"{force + other:.0f} N sideways" in note


def test_a_run_evaluates_in_the_conditions_of_its_scenario(file: Path, tmp_path: Path) -> None:
    assert quick_train(tmp_path / "runs", file, "--steps", 300).code == 0
    (run,) = (tmp_path / "runs" / "mine").iterdir()
    assert dockctl("evaluate", "--ckpt", run, "--episodes", 3).code == 0
    rows = read_table(run / "evaluation.csv", ("current_speed_mps", "wind_speed_mps"))
    assert rows is not None
    assert set(rows["current_speed_mps"]) == {0.05}
