"""Merge YAML trees: a file into the one that it extends, and overrides into a file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from dockctl.errors import nearest
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.schema import ACTION_KINDS, SENSOR_KINDS
from dockctl.scenarios.training import ALGORITHM, Training
from dockctl.scenarios.yaml_tree import Location, Node, input_error

SELECTORS = ("preset", "kind")
"""Keys that select the meaning of their section: a section that changes one of them inherits nothing."""
CONDITION_SECTIONS = (("conditions",), ("training", "conditions"))
KINDS = {("actions",): ACTION_KINDS, ("sensors", "lidar"): SENSOR_KINDS, ("training", "algorithm"): ALGORITHM}
"""Sections with a default kind."""


def merge(base: Node, over: Node, path: tuple[str, ...] = ()) -> Node:
    """Merge `over` into `base`: mappings key by key; other values are replaced. Locations are preserved.

    A number for a reward term replaces its weight and keeps its parameters. The name of a kind is a
    section with only this key.
    """
    if path[:-1] == ("reward", "terms"):
        base, over = _as_term(base), _as_term(over)
    if path in KINDS or path[:-1] in CONDITION_SECTIONS:
        base, over = _as_section(base), _as_section(over)
    if not isinstance(over.value, dict):
        return over
    if not isinstance(base.value, dict):
        return replace(over, problems=base.problems + over.problems)
    if any(
        key in over.value and _selected(over, key, path) != _selected(base, key, path) for key in SELECTORS
    ):
        return over
    merged: dict[str, Node] = {
        key: _added(over.value[key], base, (*path, key))
        if key not in base.value
        else merge(base.value[key], over.value[key], (*path, key))
        if key in over.value
        else base.value[key]
        for key in {**base.value, **over.value}
    }
    keys, problems = {**base.keys, **over.keys}, base.problems + over.problems
    return Node(merged, over.location, keys, problems)


def _added(node: Node, base: Node, path: tuple[str, ...]) -> Node:
    """Return a node that `base` lacks; a null that would remove a condition there has a problem.

    ``conditions.wind=null`` is valid for every scenario, also without wind, but not with a misspelled name.
    """
    *above, name = path
    if node.value is None and tuple(above) in CONDITION_SECTIONS:
        known = [*base.value] if isinstance(base.value, dict) else []
        if above == ["conditions"] and name in CONDITIONS.names():
            return node
        names = f"known: {', '.join(known)}" if known else "there are none"
        message = f"no condition '{name}' to remove ({names})"
        problem = node.location.problem(message, ".".join(path), "unknown_name", nearest(name, known))
        return replace(node, problems=(*node.problems, problem))
    if isinstance(node.value, dict) and any(path == each[: len(path)] for each in CONDITION_SECTIONS):
        empty = replace(node, value={}, keys={})
        children = {key: _added(child, empty, (*path, key)) for key, child in node.value.items()}
        return replace(node, value=children)
    return node


def _as_term(node: Node) -> Node:
    is_weight = isinstance(node.value, int | float) and not isinstance(node.value, bool)
    return Node({"weight": node}, node.location, {"weight": node.location}) if is_weight else node


def _as_section(node: Node) -> Node:
    is_kind = isinstance(node.value, str)
    return Node({"kind": node}, node.location, {"kind": node.location}) if is_kind else node


def _selected(section: Node, key: str, path: tuple[str, ...]) -> Any:
    """Return the preset or kind of a section, the default one if it names none."""
    if (node := section.get(key)) is not None:
        return node.to_python()
    if key == "preset":
        return Training.model_fields["preset"].default
    if path[:-1] in CONDITION_SECTIONS:
        return path[-1]
    return KINDS[path].default if path in KINDS else None


def put(node: Node, keys: list[str], value: Node, location: Location, done: tuple[str, ...] = ()) -> Node:
    """Merge `value` into `node` at the keys below it.

    Args:
        keys: keys of mappings, or indices of lists.
        location: location of nodes that are created.
        done: keys above `node`.

    Raises:
        InputError: a key is not an index of its list.
    """
    if not keys:
        return merge(node, value, done)
    key, *rest = keys
    if isinstance(node.value, list):
        last = len(node.value) - 1
        if not key.isdecimal() or len(key.lstrip("0")) > len(str(last)) or int(key) > last:
            message = f"'{key}' is not an index of the list {'.'.join(done)} (0 to {last})"
            raise input_error(location, message, code="out_of_range" if key.isdecimal() else "wrong_type")
        items = list(node.value)
        items[int(key)] = put(items[int(key)], rest, value, location, (*done, key))
        # Numbers in a list are one value, like the bounds of a range.
        is_value = all(isinstance(item.value, int | float) for item in items)
        return replace(node, value=items, location=location if is_value else node.location)
    inner = value
    for part in reversed(keys):
        inner = Node({part: inner}, location, {part: location})
    child = node.get(key)
    if child is None or not rest:
        return merge(node, inner, done)
    return node.with_value(key, put(child, rest, value, location, (*done, key)))


def at_location(node: Node, location: Location) -> Node:
    """Return the tree with every location set to `location`."""
    value = node.value
    if isinstance(value, dict):
        value = {key: at_location(child, location) for key, child in value.items()}
    elif isinstance(value, list):
        value = [at_location(item, location) for item in value]
    return replace(node, value=value, location=location, keys=dict.fromkeys(node.keys, location))
