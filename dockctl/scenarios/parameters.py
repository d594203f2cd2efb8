"""Check the parameters of reward terms and observation parts against the registered functions."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic.errors import PydanticSchemaGenerationError
from pydantic_core import ErrorDetails

from dockctl.errors import DockctlError, Problem
from dockctl.plugins import OBSERVATION_PARTS, REWARD_TERMS, Entry, Function, Registry
from dockctl.scenarios.translate import description, locate, unknown_key
from dockctl.scenarios.yaml_tree import Node


def function_problems(tree: Node) -> Iterator[Problem]:
    """Yield problems with names and parameters; the models check the structure."""
    first: dict[str, str] = {}
    for steps, name, body in _terms(tree):
        if name in first:
            message = f"duplicate reward term '{name}'; the first one is {first[name]}"
            yield locate(tree, steps).problem(message, "duplicate")
        first.setdefault(name, locate(tree, steps).path)
        yield from _check(
            tree, REWARD_TERMS, name, steps, body.get("params") if isinstance(body, dict) else None
        )
    for steps, name, params in _parts(tree):
        yield from _check(tree, OBSERVATION_PARTS, name, steps, params)


def _terms(tree: Node) -> Iterator[tuple[list[str], str, Any]]:
    reward = tree.get("reward")
    terms = reward.get("terms") if reward else None
    plain = terms.plain() if terms else None
    items = plain.items() if isinstance(plain, dict) else enumerate(plain) if isinstance(plain, list) else ()
    for key, body in items:
        name = body.get("term", key) if isinstance(body, dict) else key
        if isinstance(name, str):
            yield ["reward", "terms", str(key)], name, body


def _parts(tree: Node) -> Iterator[tuple[list[str], str, Any]]:
    listed = tree.get("observation")
    for index, item in enumerate(listed.plain() if listed and isinstance(listed.value, list) else ()):
        name, params = item, None
        if isinstance(item, dict) and "part" in item:
            name, params = item["part"], item.get("params")
        elif isinstance(item, dict) and len(item) == 1:
            ((name, params),) = item.items()
        if isinstance(name, str):
            yield ["observation", str(index)], name, params


def _check(
    tree: Node, registry: Registry[Function], name: str, steps: list[str], params: Any
) -> Iterator[Problem]:
    try:
        entry = registry.get(name)
    except DockctlError as error:
        spot = locate(tree, steps)
        yield spot.problem(error.message, error.code, error.suggestion, at_key=True)
        return
    given = params if isinstance(params, dict) else {}
    for key, value in given.items():
        spot = locate(tree, [*steps, "params", key])
        if key not in entry.parameters:
            yield unknown_key(spot, key, list(entry.parameters), "parameter")
        elif detail := _type_error(entry, key, value):
            yield spot.problem(*description(detail))
    for key, default in entry.parameters.items():
        if default is inspect.Parameter.empty and key not in given:
            message = f"the {registry.noun} '{name}' needs the parameter '{key}'"
            yield locate(tree, steps).problem(message, "missing_key", at_key=True)


def _type_error(entry: Entry[Function], key: str, value: Any) -> ErrorDetails | None:
    """Return the first error of a parameter by its type hint; as in JSON, a list is accepted for a tuple."""
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
