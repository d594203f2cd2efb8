"""Sections selected by `kind` are validated by the registered model; problems are located."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest
from pydantic import BeforeValidator, Field

from dockctl.errors import InputError, Problem
from dockctl.registry import Registry
from dockctl.scenarios.base import Model, Number, Positive
from dockctl.scenarios.extensions import Kind, register
from dockctl.scenarios.kinds import Kinds
from dockctl.scenarios.problems import validate
from dockctl.scenarios.yaml_tree import read_text

SHAPES: Registry[type[Any]] = Registry("shape")


@register(SHAPES, source="a test")
class Circle(Kind):
    kind: Literal["circle"] = "circle"
    radius_m: Positive = 2.0


@register(SHAPES)
class Path(Kind):
    kind: Literal["path"] = "path"
    x_m: tuple[Number, ...]


SHAPE = Kinds(SHAPES, default="circle")


class Drawing(Model):
    shape: Annotated[Kind, SHAPE] = Field(default_factory=SHAPE.make_default)


def with_names(given: Any) -> Any:
    """Add the keys of a mapping as `kind` of its sections."""
    return {name: {"kind": name, **section} for name, section in given.items()}


class Shapes(Model):
    shapes: Annotated[dict[str, Annotated[Kind, SHAPE]], BeforeValidator(with_names)]


def problem(text: str, model: type[Model] = Drawing) -> Problem:
    tree = read_text(text, "drawing.yaml")
    with pytest.raises(InputError) as caught:
        validate(tree, model)
    (found,) = caught.value.problems
    return found


def test_the_default_kind_needs_no_key() -> None:
    assert Drawing().shape == Circle()
    assert Drawing.model_validate({"shape": {"radius_m": 3}}).shape == Circle(radius_m=3)


def test_a_kind_can_be_given_by_its_name_alone() -> None:
    assert Drawing.model_validate({"shape": "circle"}).shape == Circle()


def test_the_kind_selects_the_model() -> None:
    assert Drawing.model_validate({"shape": {"kind": "path", "x_m": [1, 2]}}).shape == Path(x_m=(1, 2))


def test_a_dump_loads_as_an_equal_section() -> None:
    drawing = Drawing(shape=Path(x_m=(1, 2)))
    assert Drawing.model_validate(drawing.model_dump(mode="json")) == drawing


@pytest.mark.parametrize(
    ("text", "field", "column"),
    [
        ("shape: {radius_m: -1}", "shape.radius_m", 19),
        ("shape: {kind: cicle}", "shape.kind", 15),
        ("shape: {radius: 1}", "shape.radius", 9),
        ("shape: 3", "shape", 8),
        ("shape: {kind: path, x_m: [1, a]}", "shape.x_m.1", 30),
        ("shape: {kind: path}", "shape.x_m", 1),
    ],
)
def test_a_problem_is_located(text: str, field: str, column: int) -> None:
    found = problem(text)
    assert (found.line, found.column, found.field) == (1, column, field)


def test_an_unknown_kind_has_the_nearest_as_suggestion() -> None:
    found = problem("shape: {kind: cicle}")
    assert (found.code, found.suggestion) == ("unknown_name", "circle")


def test_an_unknown_key_has_a_key_of_that_kind_as_suggestion() -> None:
    found = problem("shape: {kind: path, x_m: [1], y_m: 2}")
    assert (found.code, found.suggestion) == ("unknown_key", "x_m")
    assert "radius_m" not in found.message


@pytest.mark.parametrize(
    ("text", "field", "code", "suggestion"),
    [
        ("shapes: {circle: {radius: 1}}", "shapes.circle.radius", "unknown_key", "radius_m"),
        ("shapes: {mine: {kind: path, x_m: [1], y_m: 2}}", "shapes.mine.y_m", "unknown_key", "x_m"),
        ("shapes: {path: {}}", "shapes.path.x_m", "missing_key", ""),
        ("shapes: {cicle: {}}", "shapes.cicle", "unknown_name", "circle"),
    ],
)
def test_a_mapping_of_kinds_selects_them_by_name(text: str, field: str, code: str, suggestion: str) -> None:
    found = problem(text, Shapes)
    assert (found.field, found.code, found.suggestion) == (field, code, suggestion)
