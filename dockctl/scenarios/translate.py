"""Say in the words of the YAML file what pydantic found wrong, and where."""

from __future__ import annotations

import types
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticUndefined

from dockctl.errors import Problem, nearest
from dockctl.plugins import HARBORS, VESSELS
from dockctl.scenarios.kinds import Kind, Kinds
from dockctl.scenarios.yaml_tree import Node, Place, described

Step = str | int

TAGS = ("kind", "side")
"""Keys whose value says which of several models a mapping is."""

EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_parsing_size": "a whole number of ordinary size",
    "bool_type": "true or false",
    "string_type": "text",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
    "greater_than": "a number greater than {gt:g}",
    "greater_than_equal": "a number of at least {ge:g}",
    "less_than": "a number less than {lt:g}",
    "less_than_equal": "a number of at most {le:g}",
    "finite_number": "a finite number",
    "too_short": "at least {min_length} item",
    "too_long": "at most {max_length} items",
    "string_too_long": "at most {max_length} characters",
    "string_pattern_mismatch": "letters, digits, dots, dashes and underscores, a letter or digit first",
    "literal_error": "{expected}",
}
"""What pydantic's kinds of error ask for."""


@dataclass(frozen=True)
class Spot:
    """A field of the input: its path, the places of its key and its value, and the value (None if absent)."""

    path: str
    key: Place
    place: Place
    node: Node | None

    def problem(self, message: str, *, at_key: bool = False) -> Problem:
        """Return a problem at the value, or at the key; an absent field is placed at the key of its owner."""
        place = self.key if at_key or self.node is None else self.place
        return place.problem(message, self.path)


def locate(tree: Node, steps: Sequence[Step]) -> Spot:
    """Walk from the root along pydantic's location or a dotted path, through short forms and union tags."""
    spot = Spot("", tree.place, tree.place, tree)
    for step in steps:
        if spot.node is None:
            break
        spot = _descend(spot, spot.node, step)
    return spot


def _descend(spot: Spot, node: Node, step: Step) -> Spot:
    def child(key: Step, value: Node | None, key_place: Place | None = None) -> Spot:
        path = f"{spot.path}.{key}" if spot.path else str(key)
        return Spot(path, key_place or spot.key, value.place if value else spot.place, value)

    value = node.value
    if isinstance(value, list):
        inside = str(step).isdecimal() and int(step) < len(value)
        return child(step, value[int(step)], value[int(step)].place) if inside else child(step, None)
    if not isinstance(value, dict):  # the short forms `final: 30000` and `- phase` are a weight and a part
        return spot
    if step in value:
        return child(step, value[str(step)], node.keys[str(step)])
    if spot.path == "reward.terms" and str(step).isdecimal():
        given = [key for key, term in value.items() if term.value is not None]
        return child(given[int(step)], value[given[int(step)]], node.keys[given[int(step)]])
    if step in ("part", "params") and len(value) == 1:  # the short form `- lidar: {cap_m: 20}`
        ((name, params),) = value.items()
        return child(name, params, node.keys[name])
    is_tag = any(tag in value and value[tag].value == step for tag in TAGS)
    return spot if is_tag else child(step, None)


def problems(error: ValidationError, tree: Node, model: type[BaseModel]) -> Iterator[Problem]:
    """Translate every error of a validation."""
    details = error.errors(include_url=False)
    for detail in details:
        if detail["type"] == "too_short" and any(_lies_in(other["loc"], detail["loc"]) for other in details):
            continue  # pydantic does not count the items that have errors of their own
        spot = locate(tree, detail["loc"])
        models = _models_at(model, tree, detail["loc"][:-1])
        if detail["type"] == "extra_forbidden":
            known = [name for owner in models for name in owner.model_fields]
            yield spot.problem(unknown_key(spot.path.rpartition(".")[2], known), at_key=True)
        elif detail["type"] == "missing" or (detail["type"] == "model_type" and detail["input"] is None):
            yield spot.problem(_missing(str(detail["loc"][-1]), models))
        elif detail["type"] == "union_tag_not_found":
            tag = detail["ctx"]["discriminator"].strip("'")
            models = _models_at(model, tree, detail["loc"])
            choices = [choice for owner in models for choice in _choices(owner, tag)]
            yield spot.problem(f"the key '{tag}' is missing (one of: {', '.join(choices)})")
        else:
            yield _named(spot, tree, detail).problem(message(detail, spot.path))


def _named(spot: Spot, tree: Node, detail: ErrorDetails) -> Spot:
    """Return the field that the message of a whole model's check begins with, where it does."""
    if detail["type"] != "value_error":
        return spot
    first = str(detail["ctx"]["error"]).split()[0].rstrip(":")
    inner = locate(tree, [*detail["loc"], *first.split(".")])
    return inner if inner.node is not None else spot


def _lies_in(inner: Sequence[Step], outer: Sequence[Step]) -> bool:
    return len(inner) > len(outer) and list(inner[: len(outer)]) == list(outer)


def unknown_key(key: str, known: Sequence[str], noun: str = "key") -> str:
    """Say that `key` is unknown, the nearest known one, and all of them."""
    return f"unknown {noun} '{key}'{nearest(key, known)} (known: {', '.join(sorted(known)) or 'none'})"


def message(detail: ErrorDetails, path: str = "") -> str:
    """Say what was found and what is allowed."""
    context: Mapping[str, Any] = detail.get("ctx", {})
    kind, found = detail["type"], detail["input"]
    if kind == "value_error":
        return str(context["error"])
    if kind == "union_tag_invalid":
        choice, choices = context["tag"], context["expected_tags"]
        tag = context["discriminator"].strip("'")
        return f"found {described(choice)} as {tag}, expected {choices}{nearest(choice, _quoted(choices))}"
    expected = EXPECTED.get(kind)
    if expected is None:
        return f"found {described(found)}: {detail['msg']}"
    close = nearest(found, _quoted(context.get("expected", ""))) if isinstance(found, str) else ""
    if kind == "greater_than" and "tolerance" in path:
        close = "; a tolerance of zero or less can never be reached"
    return f"found {described(found)}, expected {expected.format(**context)}{close}"


def _quoted(words: object) -> list[str]:
    return str(words).split("'")[1::2]


def _missing(key: str, owners: Sequence[type[BaseModel]]) -> str:
    for name, registry in (("vessel", VESSELS), ("harbor", HARBORS)):
        if key == name:
            return f"missing; name one ({', '.join(sorted(registry.names()))}) or describe it"
    annotations = [owner.model_fields[key].annotation for owner in owners if key in owner.model_fields]
    return f"missing; add '{key}: {_example(annotations[0]) if annotations else '...'}'"


def _example(annotation: Any) -> str:
    models = _models_in(annotation)
    if not models:
        return "..."
    required = [key for key, info in models[0].model_fields.items() if info.default is PydanticUndefined]
    shape = "{" + ", ".join(f"{key}: ..." for key in required) + "}"
    return shape if annotation is models[0] or isinstance(annotation, types.UnionType) else f"[{shape}]"


def _models_at(model: type[BaseModel], tree: Node, steps: Sequence[Step]) -> list[type[BaseModel]]:
    """Return the models that may stand at a location."""
    models = [model]
    for depth, step in enumerate(steps, start=1):
        if isinstance(step, int):
            continue
        fields = [owner.model_fields[step] for owner in models if step in owner.model_fields]
        if fields:
            node = locate(tree, steps[:depth]).node
            models = [inner for info in fields for inner in _models_of(info, node)]
        elif not any(issubclass(owner, Kind) for owner in models):  # the tag of a union
            models = [owner for owner in models if any(step in _choices(owner, tag) for tag in TAGS)]
    return models


def _models_of(info: FieldInfo, node: Node | None) -> list[type[BaseModel]]:
    """Return the models that a field may hold; `node` is its value, which may select one by its `kind`."""
    kinds = next((mark for mark in info.metadata if isinstance(mark, Kinds)), None)
    if kinds is None:
        return _models_in(info.annotation)
    selected = node.get("kind") if node else None
    selected_model = kinds.model(selected.plain() if selected else None)
    return [] if selected_model is None else [selected_model]


def _choices(model: type[BaseModel], field: str) -> tuple[Any, ...]:
    return get_args(model.model_fields[field].annotation) if field in model.model_fields else ()


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]
