"""The JSON Schema accepts what the loader accepts, and refuses what it refuses for reasons of shape."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft7Validator

from dockctl import plugins
from dockctl.errors import DockctlError, InputError
from dockctl.experiments.study import Study
from dockctl.scenarios import json_schema
from dockctl.scenarios.loader import dump, load, load_harbor, load_vessel
from dockctl.scenarios.yaml_tree import read_file, read_text
from tests.commands.conftest import dockctl

ROOT = Path(__file__).parents[2]
DATA = ROOT / "scenarios"
STUDY = ROOT / "studies" / "thesis" / "study.yaml"


@cache
def validator(file: str) -> Draft7Validator:
    schema = json_schema.model_schema(Study) if file == "study" else getattr(json_schema, f"{file}_schema")()
    Draft7Validator.check_schema(schema)
    return Draft7Validator(schema)


def flaws(text: str, file: str = "scenario") -> list[str]:
    return [error.message for error in validator(file).iter_errors(read_text(text, "x").to_python())]


@pytest.mark.parametrize("path", sorted(DATA.rglob("*.yaml")), ids=lambda path: path.stem)
def test_packaged_files_are_valid(path: Path) -> None:
    folder = path.relative_to(DATA).parts[0]
    file = {"vessels": "vessel", "harbors": "harbor"}.get(folder, "scenario")
    assert flaws(path.read_text(), file) == []


@pytest.mark.parametrize("name", ["s1", "s3", "marina"])
def test_resolved_scenarios_are_valid(name: str) -> None:
    """Without extends every key is there."""
    assert flaws(dump(load(name).scenario)) == []


def test_the_study_and_the_examples_are_valid() -> None:
    assert flaws(STUDY.read_text(), "study") == []
    assert flaws((ROOT / "examples" / "custom-harbor" / "s1-pontoon.yaml").read_text()) == []
    assert flaws((ROOT / "examples" / "custom-harbor" / "pontoon.yaml").read_text(), "harbor") == []
    path = ROOT / "examples" / "local-term" / "s1-gentle.yaml"
    assert flaws(path.read_text())  # nobody knows the term yet
    plugins.load_file(path.with_name("gentle.py"))
    assert not [*Draft7Validator(json_schema.scenario_schema()).iter_errors(read_file(path, "x").to_python())]


ACCEPTED = """
{}
actions: continuous
actions: {kind: grid, rudder_deg: [-10, 10]}
sensors: {lidar: planar}
sensors: {lidar: {rays: 90, kind: planar}}
training: {algorithm: {kind: sb3, model: DQN, hyperparameters: {tau: 0.5}}}
training: {algorithm: sb3}
training: {stop: null, exploring_starts: null, epsilon: {end: 0.1}}
conditions: {current: {speed_mps: 0.1, direction_deg: [0, 360]}}
conditions: {current: null, tide: {kind: current, speed_mps: [0, 0.1], direction_deg: 0}}
observation: [distance, {lidar: {cap_m: 10}}, {part: lidar, params: {cap_m: 10}}, {phase: null}]
reward: {terms: {speed: -1, distance: null, slow: {term: progress, weight: 2}}}
reward: {terms: {speed: {params: {floor_m: 0.2}}}}
reward: {terms: [{term: final, weight: 1}, {term: speed, weight: -1, params: {floor_m: 0.2}}]}
vessel: {mass_kg: 160}
vessel: eilbrecht
harbor: haven
harbor: {fleet: {seed: 3}}
harbor: {kind: meshes, meshes: [{path: x.stl, shift_m: [1, 2, 3]}]}
task: {intermediate: null, final_tolerance: {speed_mps: 0.2}}
task: {berths: {trained: {east: [0]}}}
evaluation: {poses: [{x_m: 20, y_m: 2, heading_deg: 160}]}
""".strip().splitlines()


@pytest.mark.parametrize("text", ACCEPTED)
def test_every_form_that_the_loader_accepts(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    content = f"extends: s1\n{text if text != '{}' else ''}\n"
    path.write_text(content)
    load(path)
    assert flaws(content) == []


REFUSED = """
training: {boat: 3}
training: {boats: 0}
training: {boats: "3"}
training: {boats: 5000}
training: {gamma: 1.5}
training: {optimizer: adan}
training: {hidden_sizes: []}
training: {algorithm: {kind: dqm}}
training: {algorithm: {kind: dqn, model: SAC}}
training: null
titel: x
task: {initial: [{x_m: 20, y_m: 2}]}
task: {initial: []}
task: {final: {x_m: far}}
task: {max_steps: true}
actions: {kind: continuous, rudder_deg: [1]}
actions: gird
sensors: {lidar: {kind: planar, channels: 4}}
observation: [distance, sonar]
observation: [{lidar: {cap: 10}}]
observation: [{lidar: {cap_m: far}}]
observation: distance
reward: {terms: {sped: -1}}
reward: {terms: {speed: fast}}
reward: {terms: {speed: {weight: -1, params: {floor: x}}}}
reward: {terms: {mine: {term: sped, weight: 1}}}
conditions: {current: {speed_mps: [0, 1, 2], direction_deg: 0}}
conditions: {current: {speed: 1}}
conditions: {tide: {kind: tides}}
vessel: eilbrect
vessel: {mass_kg: -1}
vessel: {mass: 150}
harbor: {kind: marina, rows: [{side: up, berth_y_m: [0]}]}
harbor: {rows: [{side: east, berth_x_m: [0]}]}
plugins: gentle.py
name: "two words"
""".strip().splitlines()


@pytest.mark.parametrize("text", REFUSED)
def test_mistakes_are_refused_as_by_the_loader(text: str, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(f"extends: s1\n{text}\n")
    with pytest.raises(DockctlError):
        load(path)
    assert flaws(path.read_text())


@pytest.mark.parametrize(
    "key",
    ["vessel", "harbor", "observation", "task", "reward", "task.final", "task.final.x_m", "reward.terms"],
)
def test_a_key_is_required_only_where_nothing_is_inherited(key: str, tmp_path: Path) -> None:
    data = read_text(dump(load("s1").scenario), "x").to_python()
    *parents, last = key.split(".")
    node = data
    for parent in parents:
        node = node[parent]
    del node[last]
    path = tmp_path / "x.yaml"
    path.write_text(json.dumps(data))
    with pytest.raises(InputError):
        load(path)
    assert flaws(path.read_text())
    path.write_text(json.dumps({"extends": "s1", **data}))
    load(path)
    assert flaws(path.read_text()) == []


@pytest.mark.parametrize(
    ("file", "text", "reader"),
    [
        ("vessel", "extends: eilbrecht\nmass: 3\n", load_vessel),
        ("vessel", "mass_kg: 3\n", load_vessel),
        ("vessel", "extends: elbrecht\n", load_vessel),
        ("harbor", "kind: marina\n", load_harbor),
        ("harbor", "extends: reference\nbasin: {x_min_m: a}\n", load_harbor),
    ],
)
def test_vessel_and_harbor_files(file: str, text: str, reader: Any, tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(DockctlError):
        reader(path)
    assert flaws(text, file)


def test_a_study() -> None:
    text = STUDY.read_text()
    assert flaws(re.sub("seeds: ", "seed: ", text, count=1), "study")
    assert flaws("experiments: []\n", "study")


def test_the_command(tmp_path: Path) -> None:
    outcome = dockctl("schema")
    assert json.loads(outcome.out) == json_schema.scenario_schema()
    gentle = ROOT / "examples" / "local-term" / "gentle.py"
    out = tmp_path / "schema.json"
    assert dockctl("schema", "--plugin", gentle, "--out", out).code == 0
    found = Draft7Validator(json.loads(out.read_text()))
    assert found.is_valid(
        {"extends": "s1", "reward": {"terms": {"gentle_turns": {"params": {"limit_radps": 1}}}}}
    )
    assert not found.is_valid(
        {"extends": "s1", "reward": {"terms": {"gentle_turns": {"params": {"limit": 1}}}}}
    )
    for file in ("vessel", "harbor", "study"):
        assert json.loads(dockctl("schema", file).out)["$schema"] == json_schema.DRAFT
    assert dockctl("schema", "boat").error_code == "unknown_name"
    assert dockctl("schema", "--out", tmp_path / "x.txt").code == 2
