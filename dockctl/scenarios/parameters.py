"""Check reward terms and observation parts against the functions registered under their names."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from typing import Any, get_type_hints

from pydantic import TypeAdapter, ValidationError
from pydantic.errors import PydanticSchemaGenerationError

from dockctl.errors import DockctlError, Problem
from dockctl.plugins import OBSERVATION_PARTS, REWARD_TERMS, Entry, Function, Registry
from dockctl.scenarios.translate import locate, message, unknown_key
from dockctl.scenarios.yaml_tree import Node


def function_problems(tree: Node) -> Iterator[Problem]:
    """Yield what is wrong with names and parameters; a wrong shape is left to the models."""
    first: dict[str, str] = {}
    for steps, name, body in _terms(tree):
        if name in first:
            yield locate(tree, steps).problem(
                f"the reward term '{name}' stands twice; first in {first[name]}"
            )
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
        yield locate(tree, steps).problem(str(error), at_key=True)
        return
    given = params if isinstance(params, dict) else {}
    for key, value in given.items():
        spot = locate(tree, [*steps, "params", key])
        if key not in entry.parameters:
            yield spot.problem(unknown_key(key, list(entry.parameters), "parameter"), at_key=True)
        elif complaint := _type_complaint(entry, key, value):
            yield spot.problem(complaint)
    for key, default in entry.parameters.items():
        if default is inspect.Parameter.empty and key not in given:
            message = f"the {registry.noun} '{name}' needs the parameter '{key}'"
            yield locate(tree, steps).problem(message, at_key=True)


def _type_complaint(entry: Entry[Function], key: str, value: Any) -> str:
    """Return what is wrong with a parameter by its type, or nothing; as in JSON, a list fits a tuple."""
    try:
        hint = get_type_hints(entry.value, include_extras=True).get(key, Any)
        adapter = TypeAdapter(hint)
    except (NameError, PydanticSchemaGenerationError):  # names for type checkers alone, or no plain type
        return ""
    try:
        adapter.validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        return "; ".join(message(detail) for detail in error.errors(include_url=False))
    return ""
