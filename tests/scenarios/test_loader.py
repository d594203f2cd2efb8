"""Inheritance, overrides, names and paths."""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from typing import Any

import pytest
import yaml

from dockctl.errors import DockctlError, InputError
from dockctl.plugins import HARBORS, VESSELS
from dockctl.registry import Registry
from dockctl.scenarios import catalog, loader
from dockctl.scenarios.schema import Pose, Scenario
from dockctl.scenarios.training import THESIS


def write(folder: Path, text: str, name: str = "x.yaml") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def load(folder: Path, text: str, *overrides: str) -> Scenario:
    return loader.load(write(folder, text), overrides=overrides).scenario


def refused(folder: Path, text: str) -> list[tuple[str, int, int, str, str]]:
    with pytest.raises(InputError) as caught:
        load(folder, text)
    return [
        (os.path.relpath(problem.file, folder), problem.line, problem.column, problem.field, problem.code)
        for problem in caught.value.problems
    ]


def weights(scenario: Scenario) -> dict[str, float]:
    return {term.term: term.weight for term in scenario.reward.terms}


def test_a_file_inherits_all_but_its_name(tmp_path: Path) -> None:
    scenario = load(tmp_path, "extends: s1\ntask: {max_steps: 7}\n")
    parent = loader.load("s1").scenario
    assert (scenario.name, scenario.title, scenario.description) == ("x", "", "")
    assert scenario.task == parent.task.model_copy(update={"max_steps": 7})
    assert scenario.reward == parent.reward


def test_extends_a_path_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "below").mkdir()
    write(tmp_path, "extends: s1\ntask: {max_steps: 7}\n", "parent.yaml")
    child = write(tmp_path / "below", "extends: ../parent.yaml\ntask: {final: {y_m: 0.5}}\n")
    task = loader.load(child).scenario.task
    assert (task.max_steps, task.final) == (7, Pose(x_m=36.0, y_m=0.5, heading_deg=180.0))


def test_an_inherited_error_names_the_file_that_contains_it(tmp_path: Path) -> None:
    write(tmp_path, "extends: s1\ntask:\n  max_steps: -1\n", "parent.yaml")
    assert refused(tmp_path, "extends: parent.yaml\ntask: {final: {y_m: x}}\n") == [
        ("parent.yaml", 3, 14, "task.max_steps", "out_of_range"),
        ("x.yaml", 2, 21, "task.final.y_m", "wrong_type"),
    ]


def test_a_circular_reference_is_rejected(tmp_path: Path) -> None:
    write(tmp_path, "extends: x.yaml\n", "parent.yaml")
    assert refused(tmp_path, "name: x\nextends: parent.yaml\n") == [
        ("parent.yaml", 1, 10, "extends", "invalid")
    ]


def test_lists_replace_and_null_removes_a_term(tmp_path: Path) -> None:
    scenario = load(
        tmp_path, "extends: s1\nreward: {terms: {speed: null, distance: -1}}\nobservation: [lidar]\n"
    )
    assert weights(scenario) == {"collision": -30_000, "final": 30_000, "distance": -1, "orientation": -100}
    assert [part.part for part in scenario.observation] == ["lidar"]


def test_a_number_on_a_term_keeps_its_parameters(tmp_path: Path) -> None:
    (speed,) = (
        t
        for t in load(tmp_path, "extends: s1\nreward: {terms: {speed: -3}}").reward.terms
        if t.term == "speed"
    )
    assert (speed.weight, speed.params) == (-3, {"floor_m": 0.4})


def test_the_distance_unit_can_be_meters(tmp_path: Path) -> None:
    assert load(tmp_path, "extends: s1\nreward: {distance_unit_m: 1}").reward.distance_unit_m == 1


def test_a_preset_inherits_nothing(tmp_path: Path) -> None:
    write(tmp_path, "extends: s1\ntraining: {batch_size: 64, total_steps: 9}\n", "parent.yaml")
    for training in (
        load(tmp_path, "extends: parent.yaml\ntraining: {preset: thesis, seed: 4}").training,
        load(tmp_path, "extends: parent.yaml", "training.seed=4", "training.preset=thesis").training,
    ):
        assert training.seed == 4
        assert training.model_dump(include=set(THESIS)) == THESIS


@pytest.mark.parametrize(
    ("section", "base", "over", "kept"),
    [
        (
            "conditions.wind",
            "{speed_mps: 3, direction_deg: 0, gust_mps: 1}",
            "{kind: wind, speed_mps: 5}",
            "gust_mps",
        ),
        ("sensors.lidar", "{sectors: 16}", "{kind: spinning, channels: 8}", "sectors"),
        ("actions", "{rudder_deg: [-5, 0, 5]}", "{kind: grid, propeller_n: [-5, 0, 5]}", "rudder_deg"),
        ("training", "{batch_size: 64}", "{preset: default, gamma: 0.9}", "batch_size"),
    ],
)
def test_the_name_of_a_default_kind_or_preset_changes_nothing(
    section: str, base: str, over: str, kept: str
) -> None:
    loaded = loader.load("s1", overrides=[f"{section}={base}", f"{section}={over}"])
    value: Any = loaded.scenario
    for key in section.split("."):
        value = value[key] if isinstance(value, dict) else getattr(value, key)
    assert kept in value.model_fields_set
    expected = yaml.safe_load(base)[kept]
    assert getattr(value, kept) in (
        expected,
        (expected,),
        tuple(expected) if isinstance(expected, list) else None,
    )


@pytest.mark.parametrize(
    ("overrides", "section", "expected"),
    [
        (["sensors.lidar=planar", "sensors.lidar.rays=90"], "sensors.lidar", {"kind": "planar", "rays": 90}),
        (["sensors.lidar={kind: planar, rays: 90}", "sensors.lidar=planar"], "sensors.lidar", {"rays": 90}),
        (["sensors.lidar={channels: 8}", "sensors.lidar=planar"], "sensors.lidar", {"rays": 720}),
        (["actions=incremental", "actions.rudder_step_deg=5"], "actions", {"rudder_step_deg": 5}),
        (
            ["conditions.helm=actuators", "conditions.helm.delay_steps=1"],
            "conditions.helm",
            {"delay_steps": 1},
        ),
        (
            ["training.conditions.helm=actuators", "training.conditions={helm: {delay_steps: 1}}"],
            "training.conditions.helm",
            {"delay_steps": 1},
        ),
    ],
)
def test_a_kind_without_keys_is_merged_like_a_section(
    overrides: list[str], section: str, expected: dict[str, Any]
) -> None:
    value: Any = loader.load("s1", overrides=overrides).scenario
    for key in section.split("."):
        value = value[key] if isinstance(value, dict) else getattr(value, key)
    assert value.model_dump(include=set(expected)) == expected


def test_an_index_with_many_digits_is_an_error() -> None:
    """Python refuses to convert more than 4,300 digits."""
    with pytest.raises(InputError, match="is not an index of the list observation"):
        loader.load("s1", overrides=[f"observation.{'9' * 5000}=phase"])


def test_another_kind_of_harbor_inherits_nothing(tmp_path: Path) -> None:
    harbor = load(tmp_path, "extends: s1\nharbor: {kind: meshes, meshes: [{path: a/b.obj}]}").harbor
    assert harbor.kind == "meshes"
    assert [mesh.path for mesh in harbor.meshes] == [str(tmp_path / "a" / "b.obj")]


def test_a_custom_vessel(tmp_path: Path) -> None:
    write(tmp_path, "extends: eilbrecht\nname: light\nmass_kg: 80\n", "light.yaml")
    assert load(tmp_path, "extends: s1\nvessel: light.yaml\n").vessel.mass_kg == 80
    assert load(tmp_path, "extends: s1\nvessel: {mass_kg: 99}\n").vessel.mass_kg == 99
    assert loader.load_vessel(tmp_path / "light.yaml").name == "light"


def test_paths_are_relative_to_the_file_that_contains_them(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    write(tmp_path / "a", "kind: meshes\nmeshes: [{path: quay.stl}]\n", "harbor.yaml")
    harbor = load(tmp_path, "extends: s1\nharbor: a/harbor.yaml\n").harbor
    assert harbor.kind == "meshes"
    assert harbor.meshes[0].path == str(tmp_path / "a" / "quay.stl")


def chain(folder: Path, names: list[str], last: str) -> None:
    """Write files of which each extends the next one."""
    for name, following in itertools.pairwise([*names, last]):
        write(folder, f"extends: {following}\n", name)


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({"x.yaml": "extends: s1\nvessel: b.yaml\n", "b.yaml": "vessel: b.yaml\n"}, "b.yaml vessel.vessel"),
        ({"x.yaml": "extends: s1\nharbor: h.yaml\n", "h.yaml": "harbor: h.yaml\n"}, "h.yaml harbor.harbor"),
        ({"x.yaml": "extends: s1\nvessel: b.yaml\n", "b.yaml": "extends: b.yaml\n"}, "b.yaml extends"),
        (
            {
                "x.yaml": "extends: s1\nharbor: h.yaml\n",
                "h.yaml": "extends: i.yaml\n",
                "i.yaml": "extends: h.yaml\n",
            },
            "i.yaml extends",
        ),
        ({"x.yaml": "extends: y.yaml\n", "y.yaml": "extends: ./x.yaml\n"}, "y.yaml extends"),
    ],
)
def test_files_that_name_each_other_in_a_circle(tmp_path: Path, files: dict[str, str], expected: str) -> None:
    for name, text in files.items():
        write(tmp_path, text, name)
    found = refused(tmp_path, files["x.yaml"])
    assert expected in [f"{file} {field}" for file, _, _, field, _ in found]
    assert all(line and column for _, line, column, _, _ in found)


def test_a_long_chain_of_files(tmp_path: Path) -> None:
    names = [f"{number}.yaml" for number in range(500)]
    chain(tmp_path, names, "s1")
    last = loader.MAX_FILES - 2
    assert load(tmp_path, f"extends: {names[-last]}\n") == load(tmp_path, "extends: s1\n")
    assert refused(tmp_path, f"extends: {names[0]}\n") == [(names[last], 1, 10, "extends", "out_of_range")]


def test_problems_of_different_files_are_reported_together(tmp_path: Path) -> None:
    write(tmp_path, "extends: eilbrecht\nmass: 1\n", "boat.yaml")
    text = "extends: s1\nvessel: boat.yaml\nharbor: nope\ntask: {max_steps: .nan}\nplugins: [gone.py]\n"
    assert refused(tmp_path, text) == [
        ("boat.yaml", 2, 1, "vessel.mass", "unknown_key"),
        ("x.yaml", 3, 9, "harbor", "unknown_name"),
        ("x.yaml", 4, 19, "task.max_steps", "out_of_range"),
        ("x.yaml", 5, 11, "plugins.0", "plugin"),
    ]
    assert refused(tmp_path, "extends: s1\nvessel: 3\nharbor: nope\n") == [
        ("x.yaml", 2, 9, "vessel", "wrong_type"),
        ("x.yaml", 3, 9, "harbor", "unknown_name"),
    ]


def test_what_a_missing_file_would_have_given_is_not_missed(tmp_path: Path) -> None:
    assert refused(tmp_path, "extends: s11\nharbor: {kind: mesh}\ntask: {final: {x_m: 1}}\n") == [
        ("x.yaml", 1, 10, "extends", "unknown_name"),
        ("x.yaml", 2, 16, "harbor.kind", "unknown_name"),
    ]
    write(tmp_path, "extends: eilbrech\nmass: 1\n", "boat.yaml")
    assert refused(tmp_path, "extends: s1\nvessel: boat.yaml\n") == [
        ("boat.yaml", 1, 10, "extends", "unknown_name"),
        ("boat.yaml", 2, 1, "vessel.mass", "unknown_key"),
    ]


def test_an_override_replaces_what_cannot_be_used(tmp_path: Path) -> None:
    text = "extends: s1\nvessel: nope\ntask: {max_steps: .nan}\n"
    assert load(tmp_path, text, "vessel=eilbrecht", "task.max_steps=7").task.max_steps == 7


def test_a_file_that_cannot_be_read_is_reported_where_it_is_named(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    assert refused(tmp_path, "extends: pipe.yaml\n") == [("x.yaml", 1, 10, "extends", "not_readable")]
    assert refused(tmp_path, "extends: s1\nharbor: pipe.yaml\n") == [
        ("x.yaml", 2, 9, "harbor", "not_readable")
    ]


def test_meshes_are_inside_the_folder_of_the_file_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "link.obj").symlink_to(tmp_path / "quay.obj")
    here, outside = tmp_path / "here", str(tmp_path / "quay.obj")
    for path in (outside, "../quay.obj", "link.obj", "/dev/zero.obj"):
        text = f"extends: s1\nharbor: {{meshes: [{{path: {path}}}], fleet: {{models: [skiff, {path}]}}}}\n"
        assert refused(here, text) == [
            ("x.yaml", 2, 26, "harbor.meshes.0.path", "invalid"),
            ("x.yaml", 2, 54 + len(path), "harbor.fleet.models.1", "invalid"),
        ]
        given = (f"harbor.meshes.0.path={path}", f"harbor.fleet.models=[{path}]")
        assert load(here, text, *given).harbor.meshes[0].path == os.path.realpath(path)
    text = f"extends: s1\nharbor: {{meshes: [{{path: {here}/quay.obj}}, {{path: ../here/a/quay.obj}}]}}\n"
    assert [mesh.path for mesh in load(here, text).harbor.meshes] == [
        f"{here}/quay.obj",
        f"{here}/a/quay.obj",
    ]


def test_an_override_of_many_levels(tmp_path: Path) -> None:
    for levels in (51, 5000):
        with pytest.raises(InputError):
            load(tmp_path, "extends: s1\n", ".".join(["a"] * levels) + "=1")


@pytest.mark.parametrize(
    ("override", "value"),
    [
        ("training.seed=3", 3),
        ("task.initial.0.x_m=3", 3),
        ("task.final={x_m: 30}", 30),
        ("evaluation.random_starts.episodes=5", 5),
        ("training.stop=null", None),
        ("training.learning_rate=1e-3", 1e-3),
        ("vessel.mass_kg=90", 90),
        ("reward.terms.speed=-3", -3),
        ("reward.terms.speed.params.floor_m=0.1", 0.1),
    ],
)
def test_overrides(override: str, value: object) -> None:
    scenario = loader.load("s2", overrides=[override]).scenario
    (speed,) = (term for term in scenario.reward.terms if term.term == "speed")
    found = {
        "training.seed": scenario.training.seed,
        "task.initial.0.x_m": scenario.task.initial[0].x_m,
        "task.final": scenario.task.final.x_m,
        "evaluation.random_starts.episodes": scenario.evaluation.random_starts.episodes,
        "training.stop": scenario.training.stop,
        "training.learning_rate": scenario.training.learning_rate,
        "vessel.mass_kg": scenario.vessel.mass_kg,
        "reward.terms.speed": speed.weight,
        "reward.terms.speed.params.floor_m": speed.params["floor_m"],
    }
    assert found[override.partition("=")[0]] == value
    assert len(scenario.task.initial) == 3


@pytest.mark.parametrize(
    ("override", "file", "field", "code", "suggestion"),
    [
        ("training.seed", "training.seed", "", "invalid", ""),
        ("=3", "=3", "", "invalid", ""),
        ("training..seed=3", "training..seed=3", "", "invalid", ""),
        ("training.sed=3", "training.sed", "", "unknown_key", "seed"),
        ("trainin.seed=3", "trainin.seed", "trainin", "unknown_key", "training"),
        ("training.seed=x", "training.seed", "", "wrong_type", ""),
        ("task.initial.7.x_m=3", "task.initial.7.x_m", "", "out_of_range", ""),
        ("task.initial.first=3", "task.initial.first", "", "wrong_type", ""),
        ("reward.terms.sped=-3", "reward.terms.sped", "", "unknown_name", "speed"),
        ("vessel=eilbrect", "vessel", "", "unknown_name", "eilbrecht"),
        ("title=a: b", "title", "", "wrong_type", ""),
        ("task.final=[1", "task.final", "", "yaml_syntax", ""),
        ("extends=s3", "extends", "", "invalid", ""),
    ],
)
def test_wrong_overrides(override: str, file: str, field: str, code: str, suggestion: str) -> None:
    with pytest.raises(InputError) as caught:
        loader.load("s2", overrides=[override])
    (problem,) = caught.value.problems
    assert (problem.file, problem.field) == (f"--set {file}", field)
    assert (problem.code, problem.suggestion) == (code, suggestion)


def test_a_path_takes_precedence_over_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s2").mkdir()
    write(tmp_path, "extends: s3\ntitle: mine\n", "s1")
    assert loader.load("s1").scenario.title == "mine"
    assert loader.load("s2").scenario.name == "s2"
    with pytest.raises(DockctlError, check=lambda error: error.code == "not_found"):
        loader.load("s3.yaml")


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("s4", "unknown_name"),
        ("", "not_readable"),
        ("x" * 5000, "unknown_name"),
        ("a\0b", "unknown_name"),
        ("no/such/place", "unknown_name"),
    ],
)
def test_unknown_scenarios(name: str, code: str) -> None:
    with pytest.raises(DockctlError, check=lambda error: error.code == code):
        loader.load(name)


def test_problems_of_later_checks_are_located(tmp_path: Path) -> None:
    loaded = loader.load(
        write(tmp_path, "extends: s1\ntask:\n  initial:\n    - {x_m: 1, y_m: 2, heading_deg: 3}\n")
    )
    problem = loaded.problem("task.initial.0", "blocked")
    assert str(problem) == f"{tmp_path}/x.yaml:4:7: task.initial.0: blocked"
    assert loaded.problem("task.final", "!").file.endswith("s1.yaml")


def test_a_file_name_that_is_not_a_scenario_name_requires_a_name(tmp_path: Path) -> None:
    path = write(tmp_path, "extends: s1\n", "my berth.yaml")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    (problem,) = caught.value.problems
    assert (problem.file, problem.field, problem.code) == (str(path), "name", "invalid")
    path.write_text("extends: s1\nname: my-berth\n")
    assert loader.load(path).scenario.name == "my-berth"


@pytest.mark.parametrize(
    ("setting", "largest"),
    [
        ("conditions.current={{speed_mps: {}, direction_deg: 90}}", 10),
        ("conditions.current={{speed_mps: [0, {}], direction_deg: 90}}", 10),
        ("conditions.current={{speed_mps: 0, direction_deg: 90, variation_mps: {}}}", 3),
        ("conditions.wind={{speed_mps: {}, direction_deg: 90}}", 100),
        ("conditions.wind={{speed_mps: 0, direction_deg: 90, gust_mps: {}}}", 30),
        ("training.exploring_starts.max_surge_mps={}", 10),
    ],
)
def test_speeds_for_which_no_boat_is_made_are_refused(setting: str, largest: float) -> None:
    loader.load("s1", overrides=[setting.format(largest)])
    with pytest.raises(InputError) as caught:
        loader.load("s1", overrides=[setting.format(largest + 0.1)])
    (problem,) = caught.value.problems
    assert problem.code == "out_of_range"
    assert "_mps" in str(problem)


@pytest.mark.parametrize(("registry", "part"), [(VESSELS, "vessel"), (HARBORS, "harbor")])
def test_a_vessel_or_harbor_given_as_a_scenario_is_named(
    registry: Registry[Path], part: str, tmp_path: Path
) -> None:
    catalog.fill()
    for entry in registry:
        given = tmp_path / f"{entry.name}.yaml"
        given.write_bytes(entry.value.read_bytes())
        with pytest.raises(InputError) as caught:
            loader.load(given)
        (problem,) = caught.value.problems
        assert (problem.file, problem.code) == (str(given), "mismatch")
        assert f"'{part}: {given.name}'" in problem.message
