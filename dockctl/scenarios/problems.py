"""Find the problems of a scenario, with their locations in the YAML file.

`validate` translates pydantic's errors; `function_problems` checks reward terms and observation parts
against the registered functions.
"""

from __future__ import annotations

import json
import types
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, get_args, get_type_hints

from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.errors import PydanticSchemaGenerationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticUndefined

from dockctl.errors import Code, DockctlError, InputError, Problem, nearest
from dockctl.plugins import HARBORS, OBSERVATION_PARTS, REWARD_TERMS, VESSELS, Function
from dockctl.registry import Entry, Registry
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.extensions import Kind
from dockctl.scenarios.kinds import Kinds
from dockctl.scenarios.schema import SHARED_BY_TERMS, long_part, long_term
from dockctl.scenarios.yaml_tree import Location, Node, describe

Step = str | int
M = TypeVar("M", bound=BaseModel)

TAGS = ("kind", "side")
"""Keys whose value selects the model of a mapping."""

EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
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
    "string_too_short": "a text that is not empty",
    "string_too_long": "at most {max_length} characters",
    "string_pattern_mismatch": "letters, digits, dots, dashes and underscores, a letter or digit first",
    "literal_error": "{expected}",
}
"""Expected values, by pydantic's error type."""

RANGES = (
    *("greater_than", "greater_than_equal", "less_than", "less_than_equal", "finite_number"),
    *("too_short", "too_long", "string_too_short", "string_too_long", "int_parsing_size"),
)
"""Error types of values that have the right type."""


@dataclass(frozen=True)
class FieldLocation:
    """A field of the input: path, location of its key and of its value, and the value (None if missing).

    Attributes:
        incomplete: a mapping that contains it has problems of its own, so that keys may be missing.
    """

    path: str
    key: Location
    location: Location
    node: Node | None
    incomplete: bool = False

    def problem(
        self, message: str, code: Code = "invalid", suggestion: str = "", *, at_key: bool = False
    ) -> Problem:
        """Return a problem at the value or at the key; a missing field is located at its parent's key."""
        location = self.key if at_key or self.node is None else self.location
        return location.problem(message, self.path, code, suggestion)


def locate(tree: Node, steps: Sequence[Step]) -> FieldLocation:
    """Follow a pydantic location, or the keys of a path, from the root, with short forms and tags."""
    field = FieldLocation("", tree.location, tree.location, tree, bool(tree.problems))
    for step in steps:
        if field.node is None:
            break
        field = _descend(field, field.node, step)
    return field


def _descend(field: FieldLocation, node: Node, step: Step) -> FieldLocation:
    def child(key: Step, value: Node | None, key_location: Location | None = None) -> FieldLocation:
        path = f"{field.path}.{key}" if field.path else str(key)
        location = value.location if value else field.location
        incomplete = field.incomplete or bool(value and value.problems)
        return FieldLocation(path, key_location or field.key, location, value, incomplete)

    value = node.value
    if isinstance(value, list):
        inside = str(step).isdecimal() and int(step) < len(value)
        return child(step, value[int(step)], value[int(step)].location) if inside else child(step, None)
    if not isinstance(value, dict):  # the short forms `final: 30000` and `- phase` are a weight and a part
        return field
    if step in value:
        return child(step, value[str(step)], node.keys[str(step)])
    if field.path == "reward.terms" and str(step).isdecimal():
        given = [key for key, term in value.items() if term.value is not None]
        return child(given[int(step)], value[given[int(step)]], node.keys[given[int(step)]])
    if step in ("part", "params") and len(value) == 1:  # the short form `- lidar: {cap_m: 20}`
        ((name, params),) = value.items()
        return child(name, params, node.keys[name])
    return field if _is_tag(step, value) else child(step, None)


def _is_tag(step: Step, value: Mapping[str, Node]) -> bool:
    """Return whether a step is not a key, but the tag that selects the model of this mapping."""
    return any(tag in value and value[tag].value == step for tag in TAGS)


def _without_ambiguous_tag(tree: Node, steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """Return a pydantic location without a tag that is also a key of its mapping, as in `kind: meshes`."""
    for depth, step in enumerate(steps):
        node = locate(tree, steps[:depth]).node
        if node and isinstance(node.value, dict) and step in node.value and _is_tag(step, node.value):
            return steps[:depth] + steps[depth + 1 :]
    return steps


def validate(tree: Node, model: type[M], problems: Iterable[Problem] = ()) -> M:
    """Return the model of a tree.

    Args:
        problems: other known problems.

    Raises:
        InputError: lists all problems, by location.
    """
    found = [*problems, *tree.all_problems()]
    try:
        valid = model.model_validate(tree.to_python())
    except ValidationError as error:
        found += _model_problems(error, tree, model)
    if found:
        raise InputError(sorted(found, key=lambda problem: (problem.file, problem.line, problem.column)))
    return valid


def _model_problems(error: ValidationError, tree: Node, model: type[BaseModel]) -> Iterator[Problem]:
    """Translate all errors of a validation except those that follow from the problems of a node."""
    details = error.errors(include_url=False)
    for detail in details:
        detail["loc"] = _without_ambiguous_tag(tree, detail["loc"])
    for detail in details:
        if detail["type"] == "too_short" and any(
            _is_inside(other["loc"], detail["loc"]) for other in details
        ):
            continue  # pydantic does not count items that have errors themselves
        field = locate(tree, detail["loc"])
        if field.incomplete and (field.node is None or field.node.problems):
            continue
        if detail["type"] == "value_error" and field.node and any(field.node.all_problems()):
            continue  # a check of the values together
        models = _models_at(model, tree, detail["loc"][:-1])
        if detail["type"] == "extra_forbidden":
            known = [
                name for owner in models for name in (*owner.model_fields, *getattr(owner, "file_keys", ()))
            ]
            above, _, key = field.path.rpartition(".")
            message = f"unknown key '{key}' (known: {', '.join(sorted(known)) or 'none'})"
            suggestion = nearest(key, [*known, *_parameters(tree, above)])
            yield field.problem(message, "unknown_key", suggestion, at_key=True)
        elif detail["type"] == "missing" or (detail["type"] == "model_type" and detail["input"] is None):
            yield field.problem(_missing(str(detail["loc"][-1]), models), "missing_key")
        elif detail["type"] == "union_tag_not_found":
            tag = detail["ctx"]["discriminator"].strip("'")
            models = _models_at(model, tree, detail["loc"])
            choices = [choice for owner in models for choice in _choices(owner, tag)]
            yield field.problem(f"the key '{tag}' is missing (one of: {', '.join(choices)})", "missing_key")
        else:
            yield _named(field, tree, detail).problem(*description(detail, field.path))


def _parameters(tree: Node, path: str) -> list[str]:
    """Return the parameters of the reward term at `path`, which are often written beside its weight."""
    names = [term["term"] for steps, term in _terms(tree) if ".".join(steps) == path]
    entries = [REWARD_TERMS.get(name) for name in names if name in REWARD_TERMS]
    return [f"params.{parameter}" for entry in entries for parameter in entry.parameters]


def _named(field: FieldLocation, tree: Node, detail: ErrorDetails) -> FieldLocation:
    """Return the field that a model's validator reports."""
    context = detail.get("ctx", {})
    error = context.get("error")
    if detail["type"] == "union_tag_invalid":
        name = context["discriminator"].strip("'")
    elif isinstance(error, FieldError):
        name = error.field
    else:
        return field
    inner = locate(tree, [*detail["loc"], *name.split(".")])
    is_name = inner.node is None and name in TAGS  # without the key `kind`, it is the name of the section
    return replace(field, location=inner.key) if is_name else inner


def _is_inside(inner: Sequence[Step], outer: Sequence[Step]) -> bool:
    return len(inner) > len(outer) and list(inner[: len(outer)]) == list(outer)


def description(detail: ErrorDetails, path: str = "") -> tuple[str, Code, str]:
    """Return the message, the code and the suggestion for a pydantic error."""
    context: Mapping[str, Any] = detail.get("ctx", {})
    kind, found = detail["type"], detail["input"]
    if kind == "value_error":
        error = context["error"]
        if isinstance(error, FieldError):
            return error.message, error.code, error.suggestion
        return str(error), "invalid", ""
    if kind == "union_tag_invalid":
        choice, choices = context["tag"], context["expected_tags"]
        message = f"found {describe(choice)}, expected {choices}"
        return message, "unknown_name", nearest(choice, _quoted(choices))
    if kind not in EXPECTED:
        return f"found {describe(found)}: {detail['msg']}", "invalid", ""
    expected = EXPECTED[kind].format(**context)
    if kind == "tuple_type" and path == "reward.terms":  # validated as the list that the mapping becomes
        expected = "a mapping of reward terms to weights, like {speed: -20}"
    if kind == "greater_than" and "tolerance" in path:
        expected += "; a tolerance of zero or less can never be reached"
    if kind == "literal_error":
        suggestion = nearest(found, _quoted(expected)) if isinstance(found, str) else ""
        return f"found {describe(found)}, expected {expected}", "unknown_name", suggestion
    code: Code = "invalid" if kind.startswith("string_pattern") else "wrong_type"
    return f"found {describe(found)}, expected {expected}", "out_of_range" if kind in RANGES else code, ""


def _quoted(words: object) -> list[str]:
    return str(words).split("'")[1::2]


def _missing(key: str, owners: Sequence[type[BaseModel]]) -> str:
    if key.isdecimal():
        return "missing; the list needs another item"
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
    """Return the models that are possible at a location."""
    models: list[type[BaseModel]] = [model]
    by_name: Kinds | None = None  # the kinds of a mapping whose keys are names of kinds
    for depth, step in enumerate(steps, start=1):
        if isinstance(step, int):
            continue
        node = locate(tree, steps[:depth]).node
        fields = [owner.model_fields[step] for owner in models if step in owner.model_fields]
        if by_name is not None:
            models, by_name = _selected(by_name, node, step), None
        elif fields:
            by_name = next(filter(None, map(_kinds_by_name, fields)), None)
            models = [inner for info in fields for inner in _models_of(info, node)]
        elif not any(issubclass(owner, Kind) for owner in models):  # the tag of a union
            models = [owner for owner in models if any(step in _choices(owner, tag) for tag in TAGS)]
    return models


def _models_of(info: FieldInfo, node: Node | None) -> list[type[BaseModel]]:
    """Return the possible models of a field; `node` is its value, whose key `kind` may select one."""
    kinds = next((mark for mark in info.metadata if isinstance(mark, Kinds)), None)
    return _models_in(info.annotation) if kinds is None else _selected(kinds, node)


def _kinds_by_name(info: FieldInfo) -> Kinds | None:
    """Return the kinds of a field like ``dict[str, Annotated[Kind, Kinds(...)]]``."""
    marks = (mark for argument in get_args(info.annotation) for mark in get_args(argument)[1:])
    return next((mark for mark in marks if isinstance(mark, Kinds)), None)


def _selected(kinds: Kinds, node: Node | None, name: str | None = None) -> list[type[BaseModel]]:
    """Return the model selected by the key `kind` of a section, else by `name` or the default."""
    kind = node.get("kind") if node else None
    model = kinds.model(kind.to_python() if kind else name)
    return [] if model is None else [model]


def _choices(model: type[BaseModel], field: str) -> tuple[Any, ...]:
    return get_args(model.model_fields[field].annotation) if field in model.model_fields else ()


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def function_problems(tree: Node) -> Iterator[Problem]:
    """Yield problems with names and parameters; the models check the structure."""
    first: dict[str, str] = {}
    for steps, term in _terms(tree):
        name = term["term"]
        if name in first:
            message = f"duplicate reward term '{name}'; the first one is {first[name]}"
            yield locate(tree, steps).problem(message, "duplicate")
        first.setdefault(name, locate(tree, steps).path)
        yield from _check(tree, REWARD_TERMS, name, steps, term.get("params"), shared=SHARED_BY_TERMS)
    listed = tree.get("observation")
    for index, item in enumerate(listed.to_python() if listed and isinstance(listed.value, list) else ()):
        part = long_part(item)
        if isinstance(part, dict) and isinstance(name := part.get("part"), str):
            yield from _check(tree, OBSERVATION_PARTS, name, ["observation", str(index)], part.get("params"))


def _terms(tree: Node) -> Iterator[tuple[list[str], dict[str, Any]]]:
    """Yield the path and the long form of every term."""
    reward = tree.get("reward")
    terms = reward.get("terms") if reward else None
    plain = terms.to_python() if terms else None
    if isinstance(plain, dict):
        plain = {name: long_term(name, value) for name, value in plain.items()}
    items = plain.items() if isinstance(plain, dict) else enumerate(plain) if isinstance(plain, list) else ()
    for key, term in items:
        if isinstance(term, dict) and isinstance(term.get("term"), str):
            yield ["reward", "terms", str(key)], term


def _check(
    tree: Node,
    registry: Registry[Function],
    name: str,
    steps: list[str],
    params: Any,
    *,
    shared: Sequence[str] = (),
) -> Iterator[Problem]:
    field = locate(tree, steps)
    try:
        entry = registry.get(name)
    except DockctlError as error:
        yield field.problem(error.message, error.code, error.suggestion, at_key=True)
        return
    given = params if isinstance(params, dict) else {}
    defaults = [key for key in shared if key in entry.parameters]
    for key, flaw in entry.parameter_errors([*given, *defaults]):
        place = locate(tree, [*steps, "params", key]) if key in given else field
        yield place.problem(flaw.message, flaw.code, flaw.suggestion, at_key=True)
    for key, value in given.items():
        place = locate(tree, [*steps, "params", key])
        known = key in entry.parameters and not place.incomplete
        if known and (detail := _type_error(entry, key, value)):
            yield place.problem(*description(detail))


def _type_error(entry: Entry[Function], key: str, value: Any) -> ErrorDetails | None:
    """Check a parameter against its type hint and return the first error; a list is accepted for a tuple."""
    try:
        hint = get_type_hints(entry.value, include_extras=True).get(key, Any)
        adapter = TypeAdapter(hint)
    except (NameError, PydanticSchemaGenerationError):  # imported for type checkers only, or not a plain type
        return None
    try:
        adapter.validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        return error.errors(include_url=False)[0]
    return None
