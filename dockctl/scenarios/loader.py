"""Load a `Scenario`: a YAML file, the files that it extends, and the overrides from the command line."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import ValidationError

from dockctl import plugins
from dockctl.errors import Code, DockctlError, InputError, Problem
from dockctl.plugins import HARBORS, SCENARIOS, VESSELS, Registry
from dockctl.scenarios import catalog
from dockctl.scenarios.base import Model
from dockctl.scenarios.harbor import HarborSpec, is_model_file
from dockctl.scenarios.problems import function_problems, locate, model_problems
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Vessel
from dockctl.scenarios.yaml_tree import (
    Location,
    Node,
    PlainDumper,
    describe,
    input_error,
    read_file,
    read_text,
)

OWN_KEYS = ("name", "title", "description")
"""Keys that are not inherited by files that extend a file."""

SELECTORS = ("preset", "kind")
"""Keys that select the meaning of their section: a section that changes one of them inherits nothing."""

BY_NAME: dict[str, Registry[Path]] = {"vessel": VESSELS, "harbor": HARBORS}


P = TypeVar("P", bound=Model)


class _VesselFile(Model):
    vessel: Vessel


class _HarborFile(Model):
    harbor: HarborSpec


@dataclass(frozen=True)
class LoadedScenario:
    """A validated scenario, its source, and the local plugins that it uses.

    Attributes:
        base_dir: directory of the scenario file.
        source: path or name that was loaded.
        tree: the merged YAML tree, for the location of later problems.
    """

    scenario: Scenario
    base_dir: Path
    source: str
    plugin_files: tuple[Path, ...] = ()
    tree: Node | None = field(default=None, compare=False, repr=False)

    def problem(self, path: str, message: str, code: Code = "invalid", suggestion: str = "") -> Problem:
        """Return a problem of the field `path`, for example ``task.final``, with its location."""
        if self.tree is None:
            return Problem(self.source, 0, 0, path, message, code, suggestion)
        return locate(self.tree, path.split(".")).problem(message, code, suggestion)


def load(
    source: str | Path, *, overrides: Sequence[str] = (), plugin_files: Sequence[Path] = ()
) -> LoadedScenario:
    """Load and validate a scenario.

    Args:
        source: path of a YAML file, or the name of a scenario.
        overrides: ``a.b.c=value`` with a YAML value; a number in the path is a list index.
        plugin_files: local ``.py`` files to load in addition to those that the scenario lists.

    Raises:
        InputError: all problems of the scenario, with their locations.
        DockctlError: the scenario or one of `plugin_files` does not exist.
    """
    catalog.fill()
    for path in plugin_files:
        plugins.load_file(path)
    path, display = catalog.find(SCENARIOS, str(source), Path())
    tree = _read(path, display, SCENARIOS, ())
    tree = reduce(_override, sorted(overrides, key=_changes_a_value), tree)
    hint = ""
    if tree.get("name") is None:
        tree = tree.with_value("name", Node(path.stem, Location(display)))
        hint = "; the name is that of the file: add 'name: ...' to the file"
    problems = list(_load_plugins(tree))
    problems += function_problems(tree)
    try:
        scenario = Scenario.model_validate(tree.to_python())
    except ValidationError as error:
        found = model_problems(error, tree, Scenario)
        problems += [replace(p, message=p.message + hint) if p.field == "name" else p for p in found]
        raise InputError(sorted(problems, key=_by_location)) from None
    if problems:
        raise InputError(sorted(problems, key=_by_location))
    files = tuple(dict.fromkeys([*(p.resolve() for p in plugin_files), *map(Path, scenario.plugins)]))
    scenario = scenario.model_copy(update={"plugins": tuple(map(str, files))})
    return LoadedScenario(scenario, path.resolve().parent, str(source), files, tree)


def load_vessel(source: str | Path) -> Vessel:
    """Load and validate a vessel by path or name.

    Raises:
        InputError: all problems of the file, with their locations.
        DockctlError: the vessel does not exist.
    """
    return _load_part(source, VESSELS, _VesselFile).vessel


def load_harbor(source: str | Path) -> HarborSpec:
    """Load and validate a harbor by path or name; raises as `load_vessel`."""
    return _load_part(source, HARBORS, _HarborFile).harbor


def dump(scenario: Scenario) -> str:
    """Return YAML that loads as an equal scenario and extends no other file."""
    data = scenario.model_dump(mode="json")
    data["observation"] = [
        {part["part"]: part["params"]} if part["params"] else part["part"] for part in data["observation"]
    ]
    data["reward"]["terms"] = {
        term.pop("term"): term if term["params"] else term["weight"] for term in data["reward"]["terms"]
    }
    return yaml.dump(data, Dumper=PlainDumper, sort_keys=False, allow_unicode=True, width=100)


def merge(base: Node, over: Node, path: tuple[str, ...] = ()) -> Node:
    """Merge `over` into `base`: mappings key by key; other values are replaced. Locations are preserved.

    A number for a reward term replaces its weight and keeps its parameters.
    """
    if path[:-1] == ("reward", "terms"):
        base, over = _as_term(base), _as_term(over)
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    if any(
        key in over.value and over.value[key].to_python() != _to_python(base.get(key)) for key in SELECTORS
    ):
        return over
    merged = {
        key: merge(base.value[key], over.value[key], (*path, key))
        if key in base.value and key in over.value
        else over.value.get(key, base.value.get(key))
        for key in {**base.value, **over.value}
    }
    return Node(merged, over.location, {**base.keys, **over.keys})  # type: ignore[arg-type]  # one of the two has the key


def _as_term(node: Node) -> Node:
    is_weight = isinstance(node.value, int | float) and not isinstance(node.value, bool)
    return Node({"weight": node}, node.location, {"weight": node.location}) if is_weight else node


def _to_python(node: Node | None) -> Any:
    return node.to_python() if node else None


def _by_location(problem: Problem) -> tuple[str, int, int]:
    return problem.file, problem.line, problem.column


def _read(path: Path, display: str, registry: Registry[Path], chain: tuple[str, ...]) -> Node:
    """Read a file and merge it into the file that it extends.

    Args:
        display: path for messages.
        chain: real paths of the files that extend this one.
    """
    tree = _expanded(read_file(path, display), path.parent)
    extends = tree.get("extends")
    if extends is None:
        return tree
    tree = tree.without("extends")
    chain = (*chain, os.path.realpath(path))
    parent_path, parent_display = _find(registry, extends, path.parent)
    if os.path.realpath(parent_path) in chain:
        raise input_error(
            extends.location, f"'{extends.value}' extends this file: circular reference", "extends"
        )
    parent = _read(parent_path, parent_display, registry, chain)
    return merge(parent.without(*OWN_KEYS), tree)


def _find(registry: Registry[Path], node: Node, directory: Path, path: str = "extends") -> tuple[Path, str]:
    if not isinstance(node.value, str):
        message = f"found {describe(node.to_python())}, expected the name or the path of a {registry.noun}"
        raise input_error(node.location, message, path, "wrong_type")
    try:
        return catalog.find(registry, node.value, directory)
    except DockctlError as error:
        raise input_error(node.location, error.message, path, error.code, error.suggestion) from None


def _expanded(tree: Node, directory: Path) -> Node:
    """Replace the names of vessels and harbors by their content, and make paths absolute."""
    for key, registry in BY_NAME.items():
        node = tree.get(key)
        if node is not None and isinstance(node.value, str):
            tree = tree.with_value(key, _read(*_find(registry, node, directory, key), registry, ()))
    if (listed := tree.get("plugins")) is not None:
        tree = tree.with_value("plugins", _absolute(listed, directory))
    if (harbor := tree.get("harbor")) is not None:
        tree = tree.with_value("harbor", _expanded(harbor, directory))
    if (meshes := tree.get("meshes")) is not None:  # in a harbor file, and in the `harbor` of a scenario
        tree = tree.with_value("meshes", _absolute(meshes, directory))
    if (fleet := tree.get("fleet")) is not None and (models := fleet.get("models")) is not None:
        tree = tree.with_value("fleet", fleet.with_value("models", _absolute_models(models, directory)))
    return tree


def _absolute_models(models: Node, directory: Path) -> Node:
    if not isinstance(models.value, list):
        return models
    files = (isinstance(item.value, str) and is_model_file(item.value) for item in models.value)
    items = [
        _absolute(item, directory) if file else item for item, file in zip(models.value, files, strict=True)
    ]
    return Node(items, models.location)


def _absolute(node: Node, directory: Path) -> Node:
    """Make absolute paths of a string, the strings of a list, or the ``path`` of a mapping."""
    if isinstance(node.value, str):
        return Node(os.path.realpath(directory / node.value), node.location)
    if isinstance(node.value, list):
        return Node([_absolute(item, directory) for item in node.value], node.location)
    path = node.get("path")
    return (
        node.with_value("path", _absolute(path, directory)) if path and isinstance(path.value, str) else node
    )


def _changes_a_value(override: str) -> bool:
    """Sort key: overrides that select the meaning of a section come before those of its values."""
    return override.partition("=")[0].rpartition(".")[2] not in SELECTORS


def _override(tree: Node, override: str) -> Node:
    """Apply one override ``a.b.c=value``."""
    name, equals, text = override.partition("=")
    location = Location(f"--set {name}")
    if not equals or not all(name.split(".")):
        raise input_error(Location(f"--set {override}"), "expected KEY=VALUE, for example training.seed=3")
    value = _at(read_text(text, location.file), location)
    return _expanded(_put(tree, name.split("."), value, location, ()), Path())


def _put(node: Node, keys: list[str], value: Node, location: Location, done: tuple[str, ...]) -> Node:
    if not keys:
        return merge(node, value, done)
    key, *rest = keys
    if isinstance(node.value, list):
        if not key.isdecimal() or int(key) >= len(node.value):
            last = len(node.value) - 1
            message = f"'{key}' is not an index of the list {'.'.join(done)} (0 to {last})"
            raise input_error(location, message, code="out_of_range" if key.isdecimal() else "wrong_type")
        items = list(node.value)
        items[int(key)] = _put(items[int(key)], rest, value, location, (*done, key))
        return Node(items, node.location)
    inner = value
    for part in reversed(keys):
        inner = Node({part: inner}, location, {part: location})
    child = node.get(key)
    if child is None or not rest:
        return merge(node, inner, done)
    return node.with_value(key, _put(child, rest, value, location, (*done, key)))


def _at(node: Node, location: Location) -> Node:
    """Return the tree with every location set to `location`."""
    if isinstance(node.value, dict):
        moved = {key: _at(child, location) for key, child in node.value.items()}
        return Node(moved, location, dict.fromkeys(moved, location))
    if isinstance(node.value, list):
        return Node([_at(item, location) for item in node.value], location)
    return Node(node.value, location)


def _load_part(source: str | Path, registry: Registry[Path], model: type[P]) -> P:
    (key,) = model.model_fields
    node = _read(*catalog.find(registry, str(source), Path()), registry, ())
    tree = Node({key: node}, node.location, {key: node.location})
    try:
        return model.model_validate(tree.to_python())
    except ValidationError as error:
        raise InputError(sorted(model_problems(error, tree, model), key=_by_location)) from None


def _load_plugins(tree: Node) -> Iterable[Problem]:
    listed = tree.get("plugins")
    for index, node in enumerate(listed.value if listed and isinstance(listed.value, list) else ()):
        if isinstance(node.value, str):
            try:
                plugins.load_file(Path(node.value))
            except DockctlError as error:
                yield node.location.problem(error.message, f"plugins.{index}", error.code, error.suggestion)
