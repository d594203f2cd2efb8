"""Study files: their schema, their errors, and that the packaged study fits the scenarios."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import DockctlError, InputError
from dockctl.experiments.study import Experiment, load_study, make_jobs
from dockctl.scenarios.loader import load

THESIS = load_study("thesis")


def write(folder: Path, text: str) -> str:
    path = folder / "study.yaml"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("experiment", THESIS.experiments, ids=lambda experiment: experiment.name)
def test_every_experiment_of_the_packaged_study_is_a_valid_scenario(experiment: Experiment) -> None:
    scenario = load(experiment.scenario, overrides=experiment.overrides(2)).scenario
    assert scenario.training.seed == 2
    for other in experiment.evaluate_on:
        assert load(other).scenario.task.final


def test_thesis_learner_trains_its_full_number_of_episodes_in_both_units() -> None:
    found = set()
    for experiment in THESIS.chosen(["thesis"]):
        scenario = load(experiment.scenario, overrides=experiment.overrides(0)).scenario
        training = scenario.training
        assert training.preset == "thesis"
        assert training.max_episodes is not None
        assert training.total_steps >= training.max_episodes * scenario.task.max_steps
        found.add((scenario.name, training.max_episodes, scenario.reward.distance_unit_m))
    assert found == {(s, n, u) for s, n in (("s1", 4000), ("s2", 4700), ("s3", 4000)) for u in (20.0, 1.0)}


def test_experiments_are_chosen_by_name_or_group_in_the_order_of_the_study() -> None:
    names = [experiment.name for experiment in THESIS.chosen(["velocity", "s1"])]
    assert names == ["s1", "s3-velocity-20"]
    assert THESIS.chosen([]) == THESIS.experiments
    with pytest.raises(DockctlError) as caught:
        THESIS.chosen(["ablations"])
    assert (caught.value.code, caught.value.suggestion) == ("unknown_name", "ablation")


def test_every_problem_has_its_location(tmp_path: Path) -> None:
    source = write(
        tmp_path,
        "experiments:\n"
        "  - {name: a, group: g, scenario: s1, sees: 3}\n"
        "  - {name: b, group: g, scenario: s1, probes: [mop]}\n"
        "  - {name: c c, group: g, scenario: s1, seeds: 0}\n",
    )
    with pytest.raises(InputError) as raised:
        load_study(source)
    assert {(p.line, p.field, p.code, p.suggestion) for p in raised.value.problems} == {
        (2, "experiments.0.sees", "unknown_key", "seeds"),
        (3, "experiments.1.probes.0", "unknown_name", "map"),
        (4, "experiments.2.seeds", "out_of_range", ""),
        (4, "experiments.2.name", "invalid", ""),
    }


@pytest.mark.parametrize("name", ["study.json", "scenes"])
def test_an_experiment_is_not_named_like_a_file_of_the_archive(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        load_study(write(tmp_path, f"experiments:\n  - {{name: {name}, group: g, scenario: s1}}\n"))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (2, "experiments.0.name", "invalid")


def test_names_are_unique(tmp_path: Path) -> None:
    row = "  - {name: a, group: g, scenario: s1}\n"
    with pytest.raises(InputError) as caught:
        load_study(write(tmp_path, "experiments:\n" + row + row))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (3, "experiments.1.name", "duplicate")


def test_name_comes_from_the_file_unless_it_is_set(tmp_path: Path) -> None:
    row = "experiments: [{name: a, group: g, scenario: s1}]\n"
    assert load_study(write(tmp_path, row)).name == "study"
    assert load_study(write(tmp_path, "name: mine\n" + row)).name == "mine"
    bad = tmp_path / "my study.yaml"
    bad.write_text(row)
    with pytest.raises(InputError) as caught:
        load_study(str(bad))
    (problem,) = caught.value.problems
    assert (problem.file, problem.field, problem.code) == (str(bad), "name", "invalid")


def test_packaged_study_name_cannot_be_reused(tmp_path: Path) -> None:
    row = "experiments: [{name: a, group: g, scenario: s1}]\n"
    with pytest.raises(InputError) as caught:
        load_study(write(tmp_path, row + "name: thesis\n"))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (2, "name", "duplicate")


def test_every_key_is_documented_with_its_default() -> None:
    text = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    for name, field in Experiment.model_fields.items():
        default = {"": "empty", (): "[]"}.get(field.default, field.default)
        shown = "required" if field.is_required() else default
        assert f"| `{name}` | {shown} |" in text


def test_the_study_in_the_document_is_valid(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "studies.md").read_text(encoding="utf-8")
    study = load_study(write(tmp_path, text.partition("```yaml\n")[2].partition("```")[0]))
    assert [experiment.seeds for experiment in study.experiments] == [3, 3]


def test_an_unknown_study_has_a_suggestion() -> None:
    with pytest.raises(DockctlError) as caught:
        load_study("thesys")
    assert (caught.value.code, caught.value.suggestion) == ("unknown_name", "thesis")
    with pytest.raises(DockctlError, check=lambda error: error.code == "not_found"):
        load_study("nowhere.yaml")


def test_the_seed_is_no_setting(tmp_path: Path) -> None:
    row = "{name: a, group: g, scenario: s1, set: [training.gamma=0.9, training.seed=3]}"
    with pytest.raises(InputError) as caught:
        load_study(write(tmp_path, f"experiments:\n  - {row}\n"))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (2, "experiments.0.set.1", "invalid")


def transfer(*evaluate_on: str, **given: object) -> tuple[tuple[str, str], ...]:
    facts = {"name": "a", "group": "g", "scenario": "s1", "evaluate_on": evaluate_on, **given}
    (job,) = make_jobs([Experiment.model_validate(facts)], Path("runs"))
    return job.transfer


def test_the_own_scenario_is_not_another_one_to_evaluate_on(tmp_path: Path) -> None:
    assert transfer("s2", "s1", "s2", set=["training.gamma=0.9"]) == (("s2", "s2"),)
    assert transfer("s1", set=["task.max_steps=400"]) == (("s1", "s1"),)


def test_other_scenarios_to_evaluate_on_have_different_names(tmp_path: Path) -> None:
    same, other = tmp_path / "same.yaml", tmp_path / "other.yaml"
    same.write_text("extends: s2\nname: s2\n")
    other.write_text("extends: s3\nname: s2\n")
    assert transfer("s2", str(same)) == (("s2", "s2"),)
    with pytest.raises(DockctlError, match=r"experiment a: evaluate_on: .*other\.yaml.* 's2'") as caught:
        transfer(str(same), str(other))
    assert caught.value.code == "duplicate"


def test_an_unknown_scenario_is_located_in_the_study(tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(
        "experiments:\n  - {name: a, group: b, scenario: s1}\n  - {name: b, group: b, scenario: s9}\n"
    )
    with pytest.raises(DockctlError, match=r"own\.yaml:3:5: experiment b: .*'s9'"):
        make_jobs(load_study(str(path)).experiments, tmp_path / "runs")
