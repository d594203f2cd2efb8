"""Every value of a resolved scenario, with the file and line that it comes from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dockctl.scenarios.catalog import display_path
from dockctl.scenarios.loader import LoadedScenario, plain
from dockctl.scenarios.problems import Step, locate
from dockctl.scenarios.training import PRESETS
from dockctl.scenarios.yaml_tree import Location, Node, PlainDumper

DEFAULT = "default"
COMMENT_COLUMN = 40
"""Maximum column of aligned comments, so that the path of a packaged file ends within 80 columns."""
FILE_NAME = "file name"


@dataclass(frozen=True)
class Setting:
    """A value of a scenario.

    Attributes:
        path: keys and indices from the root, in the short form of terms and parts.
        value: a scalar, or a list of scalars.
        origin: ``FILE:LINE``, ``--set KEY``, ``preset NAME``, ``file name`` or ``default``.
        location: location in the file; None if the value is not from a file.
    """

    path: tuple[Step, ...]
    value: Any
    origin: str
    location: Location | None = None

    @property
    def field(self) -> str:
        """Dotted path, as for ``--set``."""
        return ".".join(map(str, self.path))

    def to_json(self) -> dict[str, Any]:
        """Return the field, its value and its origin, and file and line if there are any."""
        place = {"file": self.location.file, "line": self.location.line} if self.location else {}
        return {"field": self.field, "value": self.value, "origin": self.origin, **place}


def settings(loaded: LoadedScenario) -> list[Setting]:
    """Return every value of a scenario in the order of its models."""
    assert loaded.tree is not None  # of a file, not of an object
    return list(_settings(loaded, loaded.tree, plain(loaded.scenario), (), ()))


def to_yaml(listed: Sequence[Setting]) -> str:
    """Return YAML in which every value has its origin as a comment."""
    rows: list[tuple[str, str]] = []
    above: tuple[Step, ...] = ()
    for setting in listed:
        *parents, last = setting.path
        shared = 0
        while shared < min(len(parents), len(above)) and parents[shared] == above[shared]:
            shared += 1
        dash = ""
        for depth in range(shared, len(setting.path)):
            key = setting.path[depth]
            indent = dash or "  " * depth
            if isinstance(key, int):
                dash = f"{indent}- "
                continue
            value = f" {_flow(setting.value)}" if depth == len(parents) else ""
            rows.append((f"{indent}{_flow(key)}:{value}", setting.origin if value else ""))
            dash = ""
        if isinstance(last, int):
            rows.append((f"{dash}{_flow(setting.value)}", setting.origin))
        above = setting.path
    width = min(max((len(text) for text, origin in rows if origin), default=0), COMMENT_COLUMN)
    lines = (f"{text:<{width}}  # {origin}" if origin else text for text, origin in rows)
    return "".join(f"{line}\n" for line in lines)


def _settings(
    loaded: LoadedScenario, tree: Node, value: Any, path: tuple[Step, ...], steps: tuple[Step, ...]
) -> Iterator[Setting]:
    """Yield the settings of a part of a scenario.

    Args:
        path: path of the part, in the short form of terms and parts.
        steps: the same in the long form, which `locate` follows.
    """
    if isinstance(value, dict) and value:
        for index, (key, item) in enumerate(value.items()):
            inner = _long_steps(steps, key, index, item)
            yield from _settings(loaded, tree, item, (*path, key), inner)
    elif isinstance(value, list) and (_has_mappings(value) or _has_other_places(tree, steps)):
        for index, item in enumerate(value):
            yield from _settings(loaded, tree, item, (*path, index), (*steps, index))
    else:
        yield _setting(loaded, tree, value, path, steps)


def _long_steps(steps: tuple[Step, ...], key: str, index: int, value: Any) -> tuple[Step, ...]:
    if steps == ("reward", "terms"):
        return (*steps, index) if isinstance(value, dict) else (*steps, index, "weight")
    if len(steps) == 2 and steps[0] == "observation":
        return (*steps, "params")
    return (*steps, key)


def _has_mappings(value: list[Any]) -> bool:
    return any(isinstance(item, dict | list) for item in value)


def _has_other_places(tree: Node, steps: tuple[Step, ...]) -> bool:
    """Return whether an item of a list is not from the file of the list."""
    node = locate(tree, steps).node
    items = node.value if node and isinstance(node.value, list) else []
    return any(node is not None and item.location.file != node.location.file for item in items)


def _setting(
    loaded: LoadedScenario, tree: Node, value: Any, path: tuple[Step, ...], steps: tuple[Step, ...]
) -> Setting:
    field = locate(tree, steps)
    if field.node is None:
        preset = loaded.scenario.training.preset
        if path == ("plugins",) and value:
            return Setting(path, value, "--plugin")
        is_preset = field.path == ".".join(map(str, path[:2])) and path[0] == "training"
        return Setting(
            path, value, f"preset {preset}" if is_preset and path[1] in PRESETS[preset] else DEFAULT
        )
    if path == ("name",) and field.key == field.location and field.location.line:
        return Setting(path, value, FILE_NAME)
    if not field.location.line:  # from the command line
        return Setting(path, value, field.location.file)
    place = Location(display_path(Path(field.location.file)), field.location.line, field.location.column)
    return Setting(path, value, f"{place.file}:{place.line}", place)


def _flow(value: Any) -> str:
    """Return a scalar, or a list of scalars, as YAML in one line."""
    text: str = yaml.dump(
        value, Dumper=PlainDumper, default_flow_style=True, allow_unicode=True, width=float("inf")
    )
    return text.removesuffix("...\n").strip()
