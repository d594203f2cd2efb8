"""From a YAML file, what it extends and the overrides of the command line, to one checked `Scenario`."""

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
from dockctl.scenarios import catalog, translate
from dockctl.scenarios.base import Model
from dockctl.scenarios.harbor import HarborSpec
from dockctl.scenarios.parameters import function_problems
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Vessel
from dockctl.scenarios.yaml_tree import Node, Place, PlainDumper, described, read_file, read_text, refusal

OWN_KEYS = ("name", "title", "description")
"""Keys that tell about one file and are not inherited by those that extend it."""

SELECTORS = ("preset", "kind")
"""Keys that choose the meaning of their whole section: a section that changes one inherits nothing."""

BY_NAME: dict[str, Registry[Path]] = {"vessel": VESSELS, "harbor": HARBORS}


P = TypeVar("P", bound=Model)


class _VesselFile(Model):
    vessel: Vessel


class _HarborFile(Model):
    harbor: HarborSpec


@dataclass(frozen=True)
class LoadedScenario:
    """A checked scenario, where it comes from, and the local plugins that it runs with."""

    scenario: Scenario
    base_dir: Path
    source: str
    plugin_files: tuple[Path, ...] = ()
    tree: Node | None = field(default=None, compare=False, repr=False)

    def problem(self, path: str, message: str, code: Code = "invalid") -> Problem:
        """Return a problem with the field `path`, for example ``task.final``, at its place in the input."""
        if self.tree is None:
            return Problem(self.source, 0, 0, path, message, code)
        return translate.locate(self.tree, path.split(".")).problem(message, code)


def load(
    source: str | Path, *, overrides: Sequence[str] = (), plugin_files: Sequence[Path] = ()
) -> LoadedScenario:
    """Load the scenario file or the known scenario `source`.

    Args:
        source: path of a YAML file, or the name of a scenario.
        overrides: ``a.b.c=value`` with a YAML value; a number in the path is an index of a list.
        plugin_files: local ``.py`` files to load beside those that the scenario names.

    Raises:
        InputError: every problem of the scenario, each with its place.
        DockctlError: the scenario or a plugin of `plugin_files` does not exist.
    """
    catalog.fill()
    for path in plugin_files:
        plugins.load_file(path)
    path, shown = catalog.find(SCENARIOS, str(source), Path())
    tree = reduce(_override, sorted(overrides, key=_is_detail), _read(path, shown, SCENARIOS, ()))
    hint = ""
    if tree.get("name") is None:
        tree = tree.replaced("name", Node(path.stem, Place(shown)))
        hint = "; it is the file's name: add 'name: ...' to the file"
    problems = list(_load_plugins(tree))
    problems += function_problems(tree)
    try:
        scenario = Scenario.model_validate(tree.plain())
    except ValidationError as error:
        found = translate.problems(error, tree, Scenario)
        problems += [replace(p, message=p.message + hint) if p.field == "name" else p for p in found]
        raise InputError(sorted(problems, key=_by_place)) from None
    if problems:
        raise InputError(sorted(problems, key=_by_place))
    files = tuple(dict.fromkeys([*(p.resolve() for p in plugin_files), *map(Path, scenario.plugins)]))
    scenario = scenario.model_copy(update={"plugins": tuple(map(str, files))})
    return LoadedScenario(scenario, path.resolve().parent, str(source), files, tree)


def load_vessel(source: str | Path) -> Vessel:
    """Load a vessel by path or name.

    Raises:
        InputError: every problem of the file.
        DockctlError: there is no such vessel.
    """
    return _load_part(source, VESSELS, _VesselFile).vessel


def load_harbor(source: str | Path) -> HarborSpec:
    """Load a harbor by path or name; errors as in `load_vessel`."""
    return _load_part(source, HARBORS, _HarborFile).harbor


def dump(scenario: Scenario) -> str:
    """Return YAML that loads as an equal scenario; it stands alone, extending nothing."""
    data = scenario.model_dump(mode="json")
    data["observation"] = [
        {part["part"]: part["params"]} if part["params"] else part["part"] for part in data["observation"]
    ]
    data["reward"]["terms"] = {
        term.pop("term"): term if term["params"] else term["weight"] for term in data["reward"]["terms"]
    }
    return yaml.dump(data, Dumper=PlainDumper, sort_keys=False, allow_unicode=True, width=100)


def merge(base: Node, over: Node, path: tuple[str, ...] = ()) -> Node:
    """Lay `over` on `base`: mappings key by key, everything else replaced; places come along.

    A number laid on a reward term replaces its weight and keeps its parameters.
    """
    if path[:-1] == ("reward", "terms"):
        base, over = _as_term(base), _as_term(over)
    if not (isinstance(base.value, dict) and isinstance(over.value, dict)):
        return over
    if any(key in over.value and over.value[key].plain() != _plain(base.get(key)) for key in SELECTORS):
        return over
    merged = {
        key: merge(base.value[key], over.value[key], (*path, key))
        if key in base.value and key in over.value
        else over.value.get(key, base.value.get(key))
        for key in {**base.value, **over.value}
    }
    return Node(merged, over.place, {**base.keys, **over.keys})  # type: ignore[arg-type]  # one of the two has the key


def _as_term(node: Node) -> Node:
    is_weight = isinstance(node.value, int | float) and not isinstance(node.value, bool)
    return Node({"weight": node}, node.place, {"weight": node.place}) if is_weight else node


def _plain(node: Node | None) -> Any:
    return node.plain() if node else None


def _by_place(problem: Problem) -> tuple[str, int, int]:
    return problem.file, problem.line, problem.column


def _read(path: Path, shown: str, registry: Registry[Path], chain: tuple[str, ...]) -> Node:
    """Read a file and lay it on what it extends."""
    tree = _expanded(read_file(path, shown), path.parent)
    extends = tree.get("extends")
    if extends is None:
        return tree
    tree = tree.without("extends")
    chain = (*chain, os.path.realpath(path))
    parent_path, parent_shown = _find(registry, extends, path.parent)
    if os.path.realpath(parent_path) in chain:
        raise refusal(extends.place, f"'{extends.value}' extends this file again, in a circle", "extends")
    parent = _read(parent_path, parent_shown, registry, chain)
    return merge(parent.without(*OWN_KEYS), tree)


def _find(registry: Registry[Path], node: Node, directory: Path, path: str = "extends") -> tuple[Path, str]:
    if not isinstance(node.value, str):
        message = f"found {described(node.plain())}, expected the name or the path of a {registry.noun}"
        raise refusal(node.place, message, path, "wrong_type")
    try:
        found = catalog.find(registry, node.value, directory)
    except DockctlError as error:
        raise refusal(node.place, error.message, path, error.code, error.suggestion) from None
    if found[0].is_dir():
        raise refusal(node.place, f"'{node.value}' is a directory; name a YAML file", path, "not_readable")
    return found


def _expanded(tree: Node, directory: Path) -> Node:
    """Put vessels and harbors in the place of their names, and make paths absolute."""
    for key, registry in BY_NAME.items():
        node = tree.get(key)
        if node is not None and isinstance(node.value, str):
            tree = tree.replaced(key, _read(*_find(registry, node, directory, key), registry, ()))
    if (listed := tree.get("plugins")) is not None:
        tree = tree.replaced("plugins", _absolute(listed, directory))
    if (harbor := tree.get("harbor")) is not None:
        tree = tree.replaced("harbor", _expanded(harbor, directory))
    if (meshes := tree.get("meshes")) is not None:  # in a harbor file, and in the `harbor` of a scenario
        tree = tree.replaced("meshes", _absolute(meshes, directory))
    return tree


def _absolute(node: Node, directory: Path) -> Node:
    """Make the texts of a list, or the ``path`` of a mapping, absolute paths."""
    if isinstance(node.value, str):
        return Node(os.path.realpath(directory / node.value), node.place)
    if isinstance(node.value, list):
        return Node([_absolute(item, directory) for item in node.value], node.place)
    path = node.get("path")
    return node.replaced("path", _absolute(path, directory)) if path and isinstance(path.value, str) else node


def _is_detail(override: str) -> bool:
    """Order the overrides that choose a section before those that change a value in it."""
    return override.partition("=")[0].rpartition(".")[2] not in SELECTORS


def _override(tree: Node, override: str) -> Node:
    """Apply one ``a.b.c=value``."""
    name, equals, text = override.partition("=")
    place = Place(f"--set {name}")
    if not equals or not all(name.split(".")):
        raise refusal(Place(f"--set {override}"), "expected KEY=VALUE, for example training.seed=3")
    value = _at(read_text(text, place.file), place)
    return _expanded(_put(tree, name.split("."), value, place, ()), Path())


def _put(node: Node, keys: list[str], value: Node, place: Place, done: tuple[str, ...]) -> Node:
    if not keys:
        return merge(node, value, done)
    key, *rest = keys
    if isinstance(node.value, list):
        if not key.isdecimal() or int(key) >= len(node.value):
            last = len(node.value) - 1
            message = f"'{key}' is not an index of the list {'.'.join(done)} (0 to {last})"
            raise refusal(place, message, code="out_of_range" if key.isdecimal() else "wrong_type")
        items = list(node.value)
        items[int(key)] = _put(items[int(key)], rest, value, place, (*done, key))
        return Node(items, node.place)
    inner = value
    for part in reversed(keys):
        inner = Node({part: inner}, place, {part: place})
    child = node.get(key)
    if child is None or not rest:
        return merge(node, inner, done)
    return node.replaced(key, _put(child, rest, value, place, (*done, key)))


def _at(node: Node, place: Place) -> Node:
    """Return the tree with every place set to `place`."""
    if isinstance(node.value, dict):
        moved = {key: _at(child, place) for key, child in node.value.items()}
        return Node(moved, place, dict.fromkeys(moved, place))
    if isinstance(node.value, list):
        return Node([_at(item, place) for item in node.value], place)
    return Node(node.value, place)


def _load_part(source: str | Path, registry: Registry[Path], model: type[P]) -> P:
    (key,) = model.model_fields
    node = _read(*catalog.find(registry, str(source), Path()), registry, ())
    tree = Node({key: node}, node.place, {key: node.place})
    try:
        return model.model_validate(tree.plain())
    except ValidationError as error:
        raise InputError(sorted(translate.problems(error, tree, model), key=_by_place)) from None


def _load_plugins(tree: Node) -> Iterable[Problem]:
    listed = tree.get("plugins")
    for index, node in enumerate(listed.value if listed and isinstance(listed.value, list) else ()):
        if isinstance(node.value, str):
            try:
                plugins.load_file(Path(node.value))
            except DockctlError as error:
                yield node.place.problem(error.message, f"plugins.{index}", error.code, error.suggestion)
