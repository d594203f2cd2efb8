"""The key ``berth`` of a scenario file, which moves the poses of the task to another berth of its marina."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, get_args

import numpy as np

from dockctl.errors import Code, DockctlError, nearest
from dockctl.geometry import pose_array, relocate_poses
from dockctl.scenarios.harbor import BerthPlace, Generated, Marina, Side, berth_pose, docked_gap
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.yaml_tree import Node, describe, input_error

BERTH = "berth"
PATTERN = rf"({'|'.join(get_args(Side))})\s+([+-]?\d+(?:\.\d+)?)"
"""Side, and position of the center line along the quay [m]."""
DECIMALS = 9
"""Decimals of the moved poses; further digits are rounding errors of the rotation."""


def at_berth(tree: Node, scenario: Scenario, given: Node) -> Node:
    """Return the tree of `scenario` with this berth free and all its poses moved there.

    Args:
        given: ``side position``, for example ``west 12``.

    Raises:
        InputError: the harbor has no such berth, or the task has ``task.berths``.
    """
    place = _place(scenario, given)
    assert isinstance(scenario.harbor, Marina)  # otherwise it has no such place
    row = scenario.harbor.row_of(place)
    free = [Node(at, given.location) for at in sorted({*row.free, place.at_m})]
    index, field = scenario.harbor.rows.index(row), f"free_{row.axis}_m"
    tree = _replaced(tree, ("harbor", "rows", index, field), Node([*free], given.location))
    final, every = pose_array(scenario.task.final), [(scenario.harbor, b) for b in scenario.harbor.berths]
    gap_m = docked_gap(every, final, scenario.vessel.hull.length_m)
    to = np.array(berth_pose(scenario.harbor, place, gap_m))
    for keys, pose in scenario.poses():
        x, y, heading = relocate_poses(pose_array(pose)[None], final, to, mirrored=False)[0].tolist()
        moved = {"x_m": x, "y_m": y, "heading_deg": math.degrees(heading)}
        moved = {key: round(value, DECIMALS) + 0.0 for key, value in moved.items()}
        moved["heading_deg"] %= 360
        for key, value in moved.items():
            tree = _replaced(tree, (*keys, key), Node(value, given.location))
    return tree


def _place(scenario: Scenario, given: Node) -> BerthPlace:
    def error(message: str, code: Code, suggestion: str = "") -> DockctlError:
        return input_error(given.location, message, BERTH, code, suggestion)

    if isinstance(scenario.harbor, Generated):
        message = "generated layouts have different berths; use 'task: {berths: {}}' to dock at all free ones"
        raise error(message, "mismatch")
    if not isinstance(scenario.harbor, Marina):
        raise error(f"the harbor '{scenario.harbor.name}' has no berths: expected kind marina", "mismatch")
    if scenario.task.berths is not None:
        raise error("the task already has berths, task.berths; remove one of the two", "mismatch")
    found = re.fullmatch(PATTERN, str(given.value).strip())
    if not isinstance(given.value, str) or not found:
        message = f"expected side and position, like 'west 12', found {describe(given.to_python())}"
        raise error(message, "wrong_type")
    known = scenario.harbor.berths
    for place in known:
        if place == (found[1], float(found[2])):
            return place
    near = [place for place in known if place.side == found[1]]
    closest = min(near, key=lambda place: abs(place.at_m - float(found[2])), default=None)
    names = ", ".join(map(str, known))
    message = f"the harbor '{scenario.harbor.name}' has no berth '{given.value}' (known: {names})"
    raise error(message, "unknown_name", str(closest or nearest(given.value, map(str, known))))


def _replaced(tree: Node, keys: Sequence[Any], value: Node) -> Node:
    """Return the tree with a new value at `keys`, the last of which may be new."""
    if not keys:
        return value
    key, *rest = keys
    if isinstance(tree.value, list):
        items = list(tree.value)
        items[key] = _replaced(items[key], rest, value)
        return replace(tree, value=items)
    child = tree.get(key)
    return tree.with_value(key, _replaced(child if child is not None else value, rest, value))
