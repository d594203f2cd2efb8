"""`dockctl evaluate`: episodes, files, output, errors."""

from __future__ import annotations

import csv
import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import typer

from dockctl.commands.evaluate import _summary_table
from dockctl.commands.options import finite
from dockctl.runs.directory import SHIPPED
from dockctl.runs.results import read_results
from dockctl.runs.tables import EVALUATION
from tests.commands.conftest import Outcome, dockctl, forget_interface, only_run, quick_train

Trained = tuple[Path, Outcome]


@pytest.fixture
def run(trained: Trained, tmp_path: Path) -> Path:
    folder = tmp_path / "runs" / "s1" / "20250101-000000-seed3"
    shutil.copytree(trained[0], folder)
    return folder


def test_the_latest_run_is_evaluated_from_poses_and_random_starts(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(run.parent.parent.parent)
    outcome = dockctl("evaluate", "--json", "result.json", "--csv", "result.csv")
    assert outcome.code == 0
    for shown in ("(20, 2, 160°)", "12345", "95 %"):
        assert shown in outcome.out, shown
    result = json.loads(Path("result.json").read_text())
    assert result["test_poses"]["episodes"] == 1
    assert result["random_starts"]["episodes"] == 3
    assert sum(result["random_starts"]["endings"].values()) == 3
    stored = json.loads((run / "evaluation.json").read_text())
    assert {**stored, "files": None} == {**result, "files": None}
    text = Path("result.csv").read_text()
    assert (run / "evaluation.csv").read_text() == text
    rows = list(csv.DictReader(text.splitlines()))
    assert list(rows[0]) == list(EVALUATION)
    assert [row["start_kind"] for row in rows] == ["pose", "random", "random", "random"]
    assert all(0 <= float(row["clearance_m"]) < 20 for row in rows)


def test_another_boat_and_weather_are_noted(run: Path) -> None:
    wind = "conditions.wind={speed_mps: 8, direction_deg: 90}"
    strong = "--set", "vessel.max_propeller_n=200", "--set", "vessel.substeps=10"
    outcome = dockctl("evaluate", run, "--episodes", 1, *strong, "--set", wind)
    assert "note: actions: use at most 50 of the 200 N of the propeller" in outcome.err
    assert "conditions.wind" not in outcome.err  # 53 N; this boat has 100 N
    outcome = dockctl("evaluate", run, "--episodes", 1, "--set", wind)
    assert "note: conditions.wind.speed_mps: wind of 8 m/s on the beam pushes with 53 N" in outcome.err
    assert "actions" not in outcome.err
    assert dockctl("evaluate", run, "--episodes", 1).err == ""


@pytest.mark.parametrize(
    "command",
    [
        ("map", "--reach-m", 0, "--headings", 0),
        ("envelope", "--factors", "distance", "--episodes", 1),
        ("view", "--set", "task.max_steps=2"),
    ],
    ids=lambda command: command[0],
)
def test_weather_is_noted_once_by_other_commands(
    run: Path, command: tuple[object, ...], tmp_path: Path
) -> None:
    out = tmp_path / ("page.html" if command[0] == "view" else "out")
    outcome = dockctl(
        *command, run, "--set", "conditions.wind={speed_mps: 8, direction_deg: 90}", "--out", out
    )
    assert outcome.code == 0, outcome.err
    assert (
        outcome.err.count("note: conditions.wind.speed_mps: wind of 8 m/s on the beam pushes with 53 N") == 1
    )
    assert not dockctl(*command, run, "--out", out).err.count("note:")


def test_starts_are_seeded_and_do_not_depend_on_their_number(run: Path) -> None:
    results = []
    for episodes, seed in ((4, 1), (4, 1), (2, 1), (2, 2)):
        assert dockctl("evaluate", "--ckpt", run, "--episodes", episodes, "--seed", seed).code == 0
        results.append((run / "evaluation.csv").read_text().splitlines())
    assert results[0] == results[1]
    assert results[0][:4] == results[2]
    assert results[2][2:] != results[3][2:]


def test_rejected_draws_of_random_starts_are_reported(run: Path) -> None:
    wide = "evaluation.random_starts.position_m=40"
    outcome = dockctl("evaluate", "--ckpt", run, "--episodes", 4, "--set", wide, "--json", run / "wide.json")
    assert outcome.code == 0
    rejected = json.loads((run / "wide.json").read_text())["rejected_draws"]
    assert rejected > 0
    assert str(rejected) in outcome.err
    assert dockctl("evaluate", "--ckpt", run, "--json", run / "near.json").code == 0
    assert json.loads((run / "near.json").read_text())["rejected_draws"] == 0


def test_tables_have_what_the_conditions_drew(run: Path) -> None:
    wind = ("--set", "conditions.wind={speed_mps: [0, 1], direction_deg: 30}")
    arguments = (
        "--ckpt",
        run,
        "--episodes",
        2,
        *wind,
        "--csv",
        run / "mine.csv",
        "--json",
        run / "mine.json",
    )
    assert dockctl("evaluate", *arguments).code == 0
    (stored,) = run.glob("evaluation-s1-*.csv")
    assert stored.read_text() == (run / "mine.csv").read_text()
    rows = list(csv.DictReader(stored.read_text().splitlines()))
    assert list(rows[0]) == [*EVALUATION, "wind_speed_mps", "wind_direction_deg", "wind_gust_mps"]
    episodes = json.loads((run / "mine.json").read_text())["episodes"]
    speeds = [episode["wind_speed_mps"] for episode in episodes]
    assert [float(row["wind_speed_mps"]) for row in rows] == pytest.approx(speeds, rel=1e-5)
    assert len(set(speeds)) == 3


@pytest.mark.parametrize("helper", ["supervisor", "planner"])
def test_a_supervisor_or_planner_is_named(run: Path, helper: str) -> None:
    outcome = dockctl("evaluate", run, "--episodes", 0, "--set", f"evaluation.{helper}=true")
    assert f"with a {helper}" in " ".join(outcome.out.split())


def test_no_random_starts(run: Path) -> None:
    assert dockctl("evaluate", "--ckpt", run, "--episodes", 0).code == 0
    assert "random_starts" not in json.loads((run / "evaluation.json").read_text())


@pytest.mark.parametrize(("asked", "code"), [("0", 0), ("1", 1)])
def test_the_least_success_sets_the_exit_code(run: Path, asked: str, code: int) -> None:
    outcome = dockctl("evaluate", "--ckpt", run, "--episodes", 1, "--min-success", asked)
    assert outcome.code == code
    assert (outcome.err == "") is (code == 0)


def test_a_policy_is_evaluated_on_another_scenario(run: Path) -> None:
    outcome = dockctl("evaluate", "--ckpt", run, "--scenario", "s2", "--episodes", 0)
    assert outcome.code == 0
    assert "'s2'" in outcome.out
    assert (run / "evaluation-s2.json").is_file()
    assert not (run / "evaluation.json").exists()


def test_the_results_of_another_checkpoint_are_in_a_folder_of_their_own(run: Path) -> None:
    last, none = run / "checkpoints" / "last", ("--episodes", 0)
    for ckpt, folder in ((run, run), (last, run / "last"), (run / "checkpoints" / "best", run)):
        assert dockctl("evaluate", "--ckpt", ckpt, *none).code == 0
        facts = json.loads((folder / "evaluation.json").read_text())
        assert Path(facts["policy"]["file"]).parent.name == ("last" if folder != run else "best")
        assert read_results(folder / "evaluation.json") == facts


@pytest.mark.parametrize(("option", "name"), [("--json", "mine.py"), ("--csv", "mine.yaml"), ("--csv", "")])
def test_a_file_of_another_type_is_not_replaced(run: Path, tmp_path: Path, option: str, name: str) -> None:
    mine = tmp_path / (name or "csv")
    mine.write_text("mine")
    outcome = dockctl("evaluate", "--ckpt", run, "--episodes", 0, option, mine)
    assert outcome.code == 2
    assert outcome.error is not None and Path(outcome.error.suggestion).suffix == f".{option[2:]}"
    assert mine.read_text() == "mine"
    assert not (run / "evaluation.json").exists()


def test_a_changed_scenario_of_the_same_name_has_files_of_its_own(run: Path, tmp_path: Path) -> None:
    (tmp_path / "s1.yaml").write_text("extends: s1\ntask: {max_steps: 5}\n")
    for source, name in ((run / "scenario.yaml", "evaluation"), (tmp_path / "s1.yaml", "evaluation-s1")):
        assert not (run / f"{name}.json").exists()
        assert dockctl("evaluate", "--ckpt", run, "--scenario", source, "--episodes", 0).code == 0
        assert (run / f"{name}.csv").is_file()


def test_the_training_section_makes_no_other_scenario(run: Path) -> None:
    text = (run / "scenario.yaml").read_text()
    trained_longer = run / "s1.yaml"
    trained_longer.write_text(text.replace("boats: 2", "boats: 3"))
    assert trained_longer.read_text() != text
    assert dockctl("evaluate", "--ckpt", run, "--scenario", trained_longer, "--episodes", 0).code == 0
    assert (run / "evaluation.json").is_file()


@pytest.mark.parametrize(
    "setting", ["observation=[distance]", "actions.rudder_deg=[0]", "sensors={lidar: {sectors: 6}}"]
)
def test_observation_and_actions_of_the_policy_cannot_be_set(run: Path, setting: str) -> None:
    outcome = dockctl("evaluate", "--ckpt", run, "--episodes", 0, "--set", setting)
    assert outcome.code == 2
    assert outcome.error_code == "mismatch"
    assert not (run / "evaluation-s1.json").exists()


def test_nan_is_no_success_rate(run: Path) -> None:
    outcome = dockctl("evaluate", "--ckpt", run, "--episodes", 0, "--min-success", "nan")
    assert outcome.code == 2
    with pytest.raises(typer.BadParameter):
        finite(math.nan)


def test_a_path_is_printed_without_markup(run: Path, tmp_path: Path) -> None:
    odd = run.rename(tmp_path / "a[old] :boat: run")
    outcome = dockctl("evaluate", "--ckpt", odd, "--episodes", 0)
    assert f" {odd / 'checkpoints' / 'best' / 'policy.json'} " in outcome.out


def test_a_policy_has_its_own_observation_and_actions_in_any_scenario(run: Path, tmp_path: Path) -> None:
    """Scenario 3 observes the phase too, and this one has two LiDAR sectors less and other actions."""
    (tmp_path / "other.yaml").write_text(
        "extends: s3\nsensors: {lidar: {sectors: 6}}\nactions: {rudder_deg: [-20, 20]}\n"
        "task: {max_steps: 5}\nevaluation: {random_starts: {episodes: 2}}\n"
    )
    outcome = dockctl(
        "evaluate", "--ckpt", run, "--scenario", tmp_path / "other.yaml", "--json", tmp_path / "o.json"
    )
    assert outcome.code == 0, outcome.err
    result = json.loads((tmp_path / "o.json").read_text())
    assert result["policy"]["interface"]["lidar_sectors"] == 8
    assert [row["phase"] for row in result["episodes"]] == [0, 0, 0]


def test_a_vessel_too_weak_for_the_policy_is_an_error(run: Path, tmp_path: Path) -> None:
    weak = "extends: s1\nactions: {propeller_n: [0, 10]}\nvessel: {max_propeller_n: 10}\n"
    (tmp_path / "weak.yaml").write_text(weak)
    outcome = dockctl("evaluate", "--ckpt", run, "--scenario", tmp_path / "weak.yaml")
    assert outcome.code == 2
    assert outcome.error is not None and "actions.propeller_n" in str(outcome.error)


def test_local_parts_of_the_observation_come_with_the_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "parts.py").write_text(
        "from dockctl.envs.observation import Columns, observation_part\n"
        "@observation_part('step_length')\n"
        "def step_length(view):\n    return Columns(['knots'], view.nu[:, :1] * 1.944, -10, 10)\n"
    )
    (tmp_path / "mine.yaml").write_text(
        "extends: s1\nplugins: [parts.py]\nobservation: [distance, step_length]\n"
    )
    assert quick_train(tmp_path / "runs", tmp_path / "mine.yaml", "--steps", 100).code == 0
    (tmp_path / "parts.py").unlink()
    run = only_run(tmp_path / "runs")
    outcome = dockctl("evaluate", "--ckpt", run, "--scenario", "s2", "--episodes", 0)
    assert outcome.code == 0, outcome.err


def test_set_values_are_in_the_file_name(run: Path) -> None:
    settings = ("--set", "harbor.fleet.seed=11", "--set", "task.final={x_m: 36, y_m: 0.1, heading_deg: 180}")
    outcome = dockctl("evaluate", "--ckpt", run, "--episodes", 1, *settings)
    assert outcome.code == 0
    assert "'s1', harbor.fleet.seed=11, task.final=" in " ".join(outcome.out.split())
    (file,) = run.glob("evaluation*.json")
    assert file.name == "evaluation-s1-harbor.fleet.seed=11-task.final=_x_m_36_y_m_0.1_heading_deg_180_.json"
    assert json.loads(file.read_text())["set"] == list(settings[1::2])


def test_the_policy_is_an_argument_or_an_option(run: Path) -> None:
    results = []
    for words in ((run,), ("--ckpt", run), ("--policy", run)):
        assert dockctl("evaluate", *words, "--episodes", 0).code == 0
        results.append((run / "evaluation.csv").read_bytes())
        (run / "evaluation.csv").unlink()
    assert results[0] == results[1] == results[2]


def test_without_a_run_the_shipped_policy_of_the_scenario_is_evaluated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("evaluate", "--scenario", "s1", "--episodes", 0, "--json", "-")
    assert outcome.code == 0
    result = json.loads(outcome.out)
    assert Path(result["policy"]["file"]).parent.name == result["scenario"] == "s1"


def test_with_json_on_standard_output_other_text_is_on_standard_error(run: Path) -> None:
    outcome = dockctl("evaluate", run, "--episodes", 0, "--json", "-")
    assert json.loads(outcome.out)["scenario"] == "s1"
    assert "(20, 2, 160°)" in outcome.err


def test_a_policy_in_checkpoints_has_a_name(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A shipped policy comes before one of the same name."""
    monkeypatch.chdir(tmp_path)
    for name in ("mine", "s1"):
        shutil.copytree(run / "checkpoints" / "last", tmp_path / "checkpoints" / name)
    for name, folder in (("mine", Path("checkpoints")), ("s1", SHIPPED)):
        outcome = dockctl("evaluate", name, "--scenario", "s1", "--episodes", 0, "--json", "-")
        assert outcome.code == 0, outcome.err
        assert Path(json.loads(outcome.out)["policy"]["file"]) == folder / name / "policy.json"


@pytest.mark.parametrize(
    ("broken", "location"),
    [
        ("scenario", "policy.json"),
        ("nowhere", "nowhere"),
        ("empty run", "run"),
        ("truncated", "policy.safetensors"),
        ("json", "policy.json"),
        ("output", "no/such/folder.csv"),
        ("both", "{run} and {run}"),
        ("a scenario", "s3-opposite"),
        ("a scenario file", "mine.yaml"),
    ],
)
def test_errors(
    run: Path, broken: str, location: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    best = run / "checkpoints" / "best"
    arguments: list[object] = ["--ckpt", run]
    if broken == "scenario":
        forget_interface(run)
        arguments += ["--scenario", "s3"]
    elif broken == "nowhere":
        arguments = ["--ckpt", "nowhere"]
    elif broken == "empty run":
        shutil.rmtree(run / "checkpoints")
    elif broken == "truncated":
        (best / "policy.safetensors").write_bytes((best / "policy.safetensors").read_bytes()[:50])
    elif broken == "json":
        (best / "policy.json").unlink()
    elif broken == "output":
        arguments += ["--csv", "no/such/folder.csv"]
    elif broken == "both":
        arguments += ["--policy", run]
    elif broken == "a scenario":
        arguments = ["s3-opposite"]
    elif broken == "a scenario file":
        arguments = ["mine.yaml"]
    outcome = dockctl("evaluate", *arguments)
    assert outcome.code == 2
    place = run if location == "run" else location.format(run=run)
    assert outcome.error is not None and str(outcome.error).partition(": ")[0].endswith(str(place))
    assert outcome.err.count("error:") == 1


def test_outcomes_precede_measurements_whichever_starts_have_them() -> None:
    """All evaluation poses dock and a random start collides; a column of each."""
    docked = {
        "docked": 1, "episodes": 1, "endings": {"docked": 1}, "least_clearance_m": 0.5,
        "mean_of_docked": {"time_s": 50.0, "path_m": 15.0}, "contact_speed_mps": None,
        "success_at_clearance_m": None,
    }  # fmt: skip
    mixed = docked | {
        "episodes": 2, "endings": {"docked": 1, "collision with quay": 1},
        "contact_speed_mps": {"mean": 0.1, "max": 0.1},
    }  # fmt: skip
    result = SimpleNamespace(summaries={"pose": docked, "random": mixed}, seed=1)
    rows = list(_summary_table(cast("Any", result)).columns[0].cells)
    assert rows.index("collision") < rows.index("minimum clearance") < rows.index("mean time")
