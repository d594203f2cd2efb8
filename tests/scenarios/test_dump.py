"""Dumping to YAML and loading again, for every scenario and for any values."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dockctl.errors import DockctlError
from dockctl.plugins import SCENARIOS
from dockctl.scenarios import catalog, loader
from dockctl.scenarios.schema import Scenario
from tests.scenarios.test_loader import load, write

catalog.fill()


@pytest.mark.parametrize("name", SCENARIOS.names())
def test_dump_gives_the_same_scenario(tmp_path: Path, name: str) -> None:
    scenario = loader.load(name).scenario
    assert load(tmp_path, loader.dump(scenario)) == scenario


TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=30)
NUMBER = st.floats(-1e6, 1e6)


@given(
    title=TEXT,
    x=st.floats(-1e4, 1e4),
    weight=NUMBER,
    floor=st.floats(1e-9, 1),
    rate=st.floats(1e-12, 1),
    phases=st.booleans(),
)
def test_dump_gives_the_same_scenario_for_any_values(
    tmp_path_factory: pytest.TempPathFactory,
    title: str,
    x: float,
    weight: float,
    floor: float,
    rate: float,
    phases: bool,
) -> None:
    base = loader.load("s3").scenario.model_dump()
    base["title"] = title
    base["task"]["final"]["x_m"] = x
    base["task"]["intermediate"] = base["task"]["intermediate"] if phases else None
    base["reward"]["terms"] = [{"term": "speed", "weight": weight, "params": {"floor_m": floor}}]
    base["training"].update(learning_rate=rate, stop=None, huber_delta=None)
    scenario = Scenario.model_validate(base)
    assert load(tmp_path_factory.getbasetemp(), loader.dump(scenario)) == scenario


KEYS = st.sampled_from(
    [
        *Scenario.model_fields,
        "extends",
        "<<",
        "final",
        "terms",
        "speed",
        "params",
        "kind",
        "meshes",
        "path",
        "poses",
    ]
)
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | NUMBER
    | TEXT
    | st.sampled_from(["s1", "eilbrecht", "meshes", "marina"]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=4),
    max_leaves=15,
)


@given(st.dictionaries(KEYS, VALUES, max_size=6), st.booleans())
def test_any_mapping_is_a_scenario_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, data: dict[str, Any], extend: bool
) -> None:
    data = {**data, "extends": "s1"} if extend else data
    path = write(tmp_path_factory.getbasetemp(), json.dumps(data), "any.yaml")
    with suppress(DockctlError):
        assert isinstance(loader.load(path).scenario, Scenario)


@given(KEYS, KEYS, VALUES)
def test_any_override_is_a_scenario_or_an_error(first: str, second: str, value: object) -> None:
    with suppress(DockctlError):
        assert isinstance(loader.load("s1", overrides=[f"{first}.{second}={value}"]).scenario, Scenario)
