"""Every value of a resolved scenario has the file and line that it comes from."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from dockctl.scenarios.loader import dump, load
from dockctl.scenarios.settings import settings, to_yaml
from dockctl.scenarios.yaml_tree import read_text
from tests.commands.conftest import dockctl

BASE = """\
vessel: eilbrecht
harbor: reference
observation:
  - distance
  - lidar: {cap_m: 20}
task:
  initial: [{x_m: 20, y_m: 2, heading_deg: 160}]
  final: {x_m: 36, y_m: 0, heading_deg: 180}
reward:
  distance_unit_m: 20
  terms:
    final: 30_000
    speed: {weight: -20, params: {floor_m: 0.4}}
training: {preset: thesis, epsilon: {end: 0.5}}
"""
OVER = """\
extends: base.yaml
reward:
  terms:
    speed: -10
conditions:
  current: {speed_mps: [0, 0.1], direction_deg: 90}
"""


@pytest.fixture
def over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("base.yaml").write_text(BASE)
    Path("over.yaml").write_text(OVER)
    return Path("over.yaml")


def origins(source: str | Path, *overrides: str) -> dict[str, str]:
    return {setting.field: setting.origin for setting in settings(load(source, overrides=overrides))}


def test_files_lines_presets_and_defaults(over: Path) -> None:
    found = origins(over)
    assert found["name"] == "file name"
    assert found["title"] == "default"
    assert found["observation.0"] == "base.yaml:4"
    assert found["observation.1.lidar.cap_m"] == "base.yaml:5"
    assert found["task.initial.0.y_m"] == "base.yaml:7"
    assert found["task.initial.0.position_offset_m"] == "default"
    assert found["reward.terms.final"] == "base.yaml:12"
    assert found["reward.terms.speed.weight"] == "over.yaml:4"
    assert found["reward.terms.speed.params.floor_m"] == "base.yaml:13"
    assert found["conditions.current.speed_mps"] == "over.yaml:6"
    assert found["training.preset"] == found["training.epsilon.end"] == "base.yaml:14"
    assert found["training.batch_size"] == "preset thesis"
    assert found["training.gamma"] == "default"
    assert found["training.epsilon.start"] == "default"  # a section that is given replaces the preset's


def test_the_file_of_a_vessel_is_its_own(over: Path) -> None:
    """The line in the file begins with the key."""
    (mass,) = (s for s in settings(load(over)) if s.field == "vessel.mass_kg")
    assert mass.location
    line = Path(mass.location.file).read_text().splitlines()[mass.location.line - 1]
    assert line.startswith("mass_kg:")


def test_the_command_line(over: Path) -> None:
    found = origins(over, "training.seed=3", "task.initial.0.x_m=21", "harbor.rows.0.berth_y_m.0=-27.5")
    assert found["training.seed"] == "--set training.seed"
    assert found["task.initial.0.x_m"] == "--set task.initial.0.x_m"
    assert found["name"] == "file name"
    assert found["harbor.rows.0.berth_y_m.0"] == "--set harbor.rows.0.berth_y_m.0"
    assert found["harbor.rows.0.berth_y_m.1"].endswith("reference.yaml:9")
    assert found["harbor.rows.1.berth_y_m"].endswith("reference.yaml:13")


def nested(listed: list[dict[str, Any]]) -> dict[str, Any]:
    """Build the tree from dotted paths, with lists as mappings of their indices."""
    tree: dict[str, Any] = {}
    for setting in listed:
        *parents, last = setting["field"].split(".")
        node = tree
        for key in parents:
            node = node.setdefault(key, {})
        assert last not in node
        node[last] = setting["value"]
    return tree


def indexed(value: Any) -> Any:
    if isinstance(value, dict) and value:
        return {key: indexed(item) for key, item in value.items()}
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return {str(index): indexed(item) for index, item in enumerate(value)}
    return value


@pytest.mark.parametrize("name", ["s1", "s2-poses", "s3", "marina", "marina-unseen"])
def test_all_values_of_the_resolved_scenario_and_no_other(name: str) -> None:
    """As YAML it loads to the same data as the resolved file that a run stores."""
    listed, resolved = settings(load(name)), read_text(dump(load(name).scenario), "x").to_python()
    assert read_text(to_yaml(listed), "x").to_python() == resolved
    assert nested([setting.to_json() for setting in listed]) == indexed(resolved)


def test_text_that_yaml_could_misread_is_quoted(over: Path) -> None:
    listed = settings(load(over, overrides=['title="a: #b"', 'description="it\'s\\nnull"']))
    assert yaml.safe_load(to_yaml(listed))["title"] == "a: #b"
    assert yaml.safe_load(to_yaml(listed))["description"] == "it's\nnull"


def test_the_resolved_scenario_has_only_one_file(tmp_path: Path) -> None:
    path = tmp_path / "resolved.yaml"
    path.write_text(dump(load("s3").scenario))
    assert {s.origin.split(":")[0] for s in settings(load(path))} == {str(path)}


def test_the_command(over: Path) -> None:
    outcome = dockctl("config", over, "--set", "training.seed=3")
    assert outcome.code == 0
    assert any(
        line.split() == ["seed:", "3", "#", "--set", "training.seed"] for line in outcome.out.splitlines()
    )
    rows = json.loads(dockctl("config", over, "--json", "-").out)
    (row,) = (row for row in rows if row["field"] == "reward.terms.final")
    assert row == {
        "field": "reward.terms.final", "value": 30_000.0, "origin": "base.yaml:12", "file": "base.yaml",
        "line": 12,
    }  # fmt: skip
    assert dockctl("config", "s9").error_code == "unknown_name"
    assert dockctl("config", over, "--set", "training.sed=3").error_code == "unknown_key"


def test_a_plugin_of_the_command_line(over: Path) -> None:
    gentle = Path(__file__).parents[2] / "examples" / "local-term" / "gentle.py"
    (plugins,) = (s for s in settings(load(over, plugin_files=[gentle])) if s.field == "plugins")
    assert (plugins.value, plugins.origin) == ([str(gentle)], "--plugin")
