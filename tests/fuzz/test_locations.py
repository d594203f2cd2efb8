"""The reported line and column are those of the mutated key or value, found with PyYAML alone."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from dockctl.errors import InputError, Problem
from dockctl.scenarios import loader
from tests.fuzz.scenario_files import Steps, at, bases, places

Marks = dict[Steps, tuple[tuple[int, int], tuple[int, int]]]

COMPLETE = bases()["s3"]
PLACES = sorted(places(COMPLETE), key=str)
SELECTORS = ("kind", "preset", "side", "extends")
"""Their values decide which other keys are known."""
FREE = ("conditions", "params", "terms", "observation")
"""Mappings with names of the user's choice, or in which a second key changes the meaning of the first."""
MAPPINGS = [
    path
    for path in [(), *PLACES]
    if isinstance(at(COMPLETE, path), dict) and at(COMPLETE, path) and not {*FREE} & {*path}
]


def marks(node: yaml.Node, path: Steps = (), key: tuple[int, int] = (1, 1)) -> Marks:
    """Return line and column of the key and of the value at every path; those of an item are the same."""

    def place(mark: yaml.Mark) -> tuple[int, int]:
        return mark.line + 1, mark.column + 1

    found = {path: (key, place(node.start_mark))}
    if isinstance(node, yaml.MappingNode):
        for name, value in node.value:
            found |= marks(value, (*path, name.value), place(name.start_mark))
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            found |= marks(value, (*path, index), place(value.start_mark))
    return found


def problems(folder: Path, data: object, flow: bool | None) -> tuple[tuple[Problem, ...], Marks]:
    text = yaml.safe_dump(data, sort_keys=False, default_flow_style=flow)
    path = folder / "x.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        loader.load(path)
    assert {problem.file for problem in caught.value.problems} == {str(path)}
    return caught.value.problems, marks(yaml.compose(text, Loader=yaml.SafeLoader))


FLOW = st.sampled_from([None, False, True])


@pytest.mark.slow
@given(st.sampled_from([path for path in PLACES if path[-1] not in SELECTORS]), FLOW)
def test_a_value_that_cannot_be_used_is_reported_at_itself(
    tmp_path_factory: pytest.TempPathFactory, path: Steps, flow: bool | None
) -> None:
    data = copy.deepcopy(COMPLETE)
    at(data, path[:-1])[path[-1]] = {"odd": [{}]}
    found, known = problems(tmp_path_factory.getbasetemp(), data, flow)
    inside = [place for steps, (*places,) in known.items() if steps[: len(path)] == path for place in places]
    assert {(problem.line, problem.column) for problem in found} <= {*inside}


@given(st.sampled_from(MAPPINGS), FLOW)
def test_an_unknown_key_is_reported_at_itself(
    tmp_path_factory: pytest.TempPathFactory, path: Steps, flow: bool | None
) -> None:
    data = copy.deepcopy(COMPLETE)
    at(data, path)["odd"] = 1
    (problem,), known = problems(tmp_path_factory.getbasetemp(), data, flow)
    assert (problem.line, problem.column) == known[(*path, "odd")][0]
    assert problem.code in {"unknown_key", "unknown_name"}


@pytest.mark.slow
@given(st.sampled_from([path for path in PLACES if isinstance(at(COMPLETE, path), int | float)]), FLOW)
def test_a_number_that_is_none_is_reported_at_itself(
    tmp_path_factory: pytest.TempPathFactory, path: Steps, flow: bool | None
) -> None:
    data = copy.deepcopy(COMPLETE)
    at(data, path[:-1])[path[-1]] = float("nan")
    (problem,), known = problems(tmp_path_factory.getbasetemp(), data, flow)
    assert (problem.line, problem.column) == known[path][1]
    assert problem.field == ".".join(map(str, path))
