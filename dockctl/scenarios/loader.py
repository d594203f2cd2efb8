"""Load a `Scenario`: a YAML file, the files that it extends, and the overrides from the command line."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import Any, TypeVar

import yaml

from dockctl import plugins
from dockctl.errors import Code, DockctlError, InputError, Problem
from dockctl.plugins import HARBORS, SCENARIOS, VESSELS
from dockctl.registry import Registry
from dockctl.scenarios import catalog
from dockctl.scenarios.base import NAME, Model
from dockctl.scenarios.harbor import HarborSpec, is_model_file
from dockctl.scenarios.merge import SELECTORS, at_location, merge, put
from dockctl.scenarios.problems import function_problems, locate, validate
from dockctl.scenarios.relocation import BERTH, at_berth
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Vessel
from dockctl.scenarios.yaml_tree import (
    MAX_DEPTH,
    Location,
    Node,
    PlainDumper,
    describe,
    input_error,
    read_file,
    read_text,
)
from dockctl.trust import allowed, is_received

OWN_KEYS = ("name", "title", "description")
"""Keys that a file does not inherit from the file that it extends."""

BY_NAME: dict[str, Registry[Path]] = {"vessel": VESSELS, "harbor": HARBORS}

MAX_FILES = 50
"""Maximum number of files that extend each other."""

_MESHES = (("meshes", "*", "path"), ("fleet", "models", "*"))
PATHS = {
    SCENARIOS.noun: (("plugins", "*"), *(("harbor", *keys) for keys in _MESHES)),
    HARBORS.noun: _MESHES,
}
"""Keys of the paths in a scenario and in a harbor; "*" is any index of a list."""


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
        received: whether the file is in a checkpoint or a run.
        rejected_starts: fractions of the random starts that are redrawn, by the field with their offsets.
        blocked_berths: names of the berths that are left out, because a pose of the task is blocked there, by
            the field that lists them. `dockctl.sim.checks.load_checked` fills in both.
    """

    scenario: Scenario
    base_dir: Path
    source: str
    plugin_files: tuple[Path, ...] = ()
    tree: Node | None = field(default=None, compare=False, repr=False)
    received: bool = False
    rejected_starts: Mapping[str, float] = field(default_factory=dict, compare=False, repr=False)
    blocked_berths: Mapping[str, Sequence[str]] = field(default_factory=dict, compare=False, repr=False)

    def is_given_by_others(self, path: str) -> bool:
        """Return whether the field `path` is from a file of a checkpoint or a run."""
        if self.tree is None:
            return self.received
        return _is_of_others(locate(self.tree, path.split(".")).location, received=self.received)

    def problem(self, path: str, message: str, code: Code = "invalid", suggestion: str = "") -> Problem:
        """Return a problem of the field `path`, for example ``task.final``, with its location."""
        if self.tree is None:
            return Problem(self.source, 0, 0, path, message, code, suggestion)
        return locate(self.tree, path.split(".")).problem(message, code, suggestion)


def load(
    source: str | Path,
    *,
    overrides: Sequence[str] = (),
    plugin_files: Sequence[Path] = (),
    received: bool = False,
    trust: bool = False,
) -> LoadedScenario:
    """Load and validate a scenario.

    Args:
        source: path of a YAML file, or the name of a scenario.
        overrides: ``a.b.c=value`` with a YAML value; a number in the path is a list index.
        plugin_files: local ``.py`` files to load in addition to those that the scenario lists.
        received: the scenario is from a checkpoint or a run, even if its folder does not show it.
        trust: run the plugins that a checkpoint or a run lists, even if not yet trusted on this machine.

    Raises:
        InputError: lists all problems of the scenario, with their locations.
        UntrustedError: it lists plugins that may not run; none has run.
        DockctlError: the scenario or one of `plugin_files` does not exist.
    """
    catalog.fill()
    for path in plugin_files:
        plugins.load_file(path)
    path, display = catalog.find(SCENARIOS, str(source), Path())
    tree = _read(SCENARIOS, path, display)
    first = tree.location
    tree = reduce(_override, sorted(overrides, key=_changes_a_value), tree)
    if tree.get("name") is None:
        tree = tree.with_value("name", _name_of_file(path, first))
    received = received or is_received(path)
    tree = _without_replaced(tree, plugin_files, received=received, trust=trust)
    berth, tree = tree.get(BERTH), tree.without(BERTH)
    failed = [*_load_plugins(tree)]
    try:
        scenario = validate(tree, Scenario, [*failed, *function_problems(tree)])
    except InputError as error:
        _require_no_part(path, first)
        if not failed:
            raise
        # Of the values, names may be unknown because the plugin that registers them did not load.
        certain = [*failed, *tree.all_problems()]
        raise InputError(p for p in error.problems if p in certain or p.code != "unknown_name") from None
    if berth is not None and berth.value is not None:
        tree = at_berth(tree, scenario, berth)
        scenario = validate(tree, Scenario)
    files = tuple(dict.fromkeys([*(p.resolve() for p in plugin_files), *map(Path, scenario.plugins)]))
    scenario = scenario.model_copy(update={"plugins": tuple(map(str, files))})
    return LoadedScenario(scenario, path.resolve().parent, str(source), files, tree, received)


def load_vessel(source: str | Path) -> Vessel:
    """Load and validate a vessel by path or name.

    Raises:
        InputError: lists all problems of the file, with their locations.
        DockctlError: the vessel does not exist.
    """
    return _load_part(source, VESSELS, _VesselFile).vessel


def load_harbor(source: str | Path) -> HarborSpec:
    """Load and validate a harbor by path or name.

    Raises:
        InputError: lists all problems of the file, with their locations.
        DockctlError: the harbor does not exist.
    """
    return _load_part(source, HARBORS, _HarborFile).harbor


def dump(scenario: Scenario) -> str:
    """Return YAML that loads as an equal scenario and extends no other file."""
    data = plain(scenario)
    return yaml.dump(data, Dumper=PlainDumper, sort_keys=False, allow_unicode=True, width=100)


def plain(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as mappings, lists and scalars, terms and parts in their short form."""
    data = scenario.model_dump(mode="json")
    data["observation"] = [
        {part["part"]: part["params"]} if part["params"] else part["part"] for part in data["observation"]
    ]
    data["reward"]["terms"] = {
        term.pop("term"): term if term["params"] else term["weight"] for term in data["reward"]["terms"]
    }
    return data


def _name_of_file(path: Path, location: Location) -> Node:
    """Return the name of a scenario whose file does not contain one."""
    if re.fullmatch(NAME, path.stem):
        return Node(path.stem, location)
    message = f"the file name '{path.stem}' cannot be the scenario's name; add 'name: ...' to the file"
    return Node(None, location, problems=(location.problem(message, "name"),))


def _read(registry: Registry[Path], path: Path, display: str) -> Node:
    """Read a file and merge it into those that it extends.

    Args:
        display: path for messages.

    Raises:
        InputError: the file cannot be read. Problems of the files that it extends are in the tree.
    """
    trees: list[Node] = []
    seen: set[str] = set()
    problems: tuple[Problem, ...] = ()
    received: Location | None = None
    tree = read_file(path, display)
    while True:
        seen.add(os.path.realpath(path))
        trees.append(_expanded(tree.without("extends"), registry, display, path.parent))
        if (extends := tree.get("extends")) is None:
            break
        if received is None and is_received(path):
            received = extends.location
        try:
            path, display = _find(registry, extends, path.parent, "extends")
            if os.path.realpath(path) in seen:
                message = f"'{extends.value}' extends this file: circular reference"
                raise input_error(extends.location, message, "extends")
            if len(trees) == MAX_FILES:
                message = f"more than {MAX_FILES} files that extend each other"
                raise input_error(extends.location, message, "extends", "out_of_range")
            tree = read_file(path, display)
            if received and (listed := tree.get("plugins")) is not None:  # the user did not name this file
                tree = tree.with_value("plugins", replace(listed, location=received))
        except InputError as error:
            problems = _at_line(error, extends.location, "extends")
            break
    merged = reduce(lambda base, over: merge(base.without(*OWN_KEYS), over), reversed(trees))
    return replace(merged, problems=(*merged.problems, *problems))


def _at_line(error: InputError, location: Location, field: str) -> tuple[Problem, ...]:
    """Return the problems of a file that `location` names; those without a line are reported there."""
    return tuple(
        problem
        if problem.line or problem.file == location.file
        else location.problem(str(problem), field, problem.code)
        for problem in error.problems
    )


def _find(registry: Registry[Path], node: Node, directory: Path, path: str) -> tuple[Path, str]:
    if node.problems:
        raise InputError(node.problems)
    if not isinstance(node.value, str):
        message = f"found {describe(node.to_python())}, expected the name or the path of a {registry.noun}"
        raise input_error(node.location, message, path, "wrong_type")
    try:
        return catalog.find(registry, node.value, directory)
    except DockctlError as error:
        raise input_error(node.location, error.message, path, error.code, error.suggestion) from None


def _named(registry: Registry[Path], node: Node, directory: Path, key: str) -> Node:
    """Return the content of the vessel or harbor that `node` names."""
    try:
        path, display = _find(registry, node, directory, key)
        return _read(registry, path, display)
    except InputError as error:
        return replace(node, value=None, problems=_at_line(error, node.location, key))


def _expanded(tree: Node, registry: Registry[Path], file: str, directory: Path | None) -> Node:
    """Replace the names of vessels and harbors with their content, and make paths absolute.

    Args:
        registry: the registry of files like this one.
        file: file of the values to expand, as in their locations; values from other files are not changed.
        directory: directory of the file, which must contain its mesh files; None for the command line, where
            any file is allowed.
    """

    def absolute(node: Node, field: str) -> Node:
        is_path = isinstance(node.value, str) and node.location.file == file
        if not is_path or ("models" in field and not is_model_file(str(node.value))):
            return node
        path = os.path.realpath((directory or Path()) / str(node.value))
        problems = node.problems
        if (
            directory
            and "plugins" not in field
            and not Path(path).is_relative_to(os.path.realpath(directory))
        ):
            message = (
                f"'{node.value}' is outside the folder of this file; move it there, or name it on the command"
                f" line: --set {field}=PATH"
            )
            problems += (node.location.problem(message, field),)
        return replace(node, value=path, problems=problems)

    if registry is SCENARIOS:
        for key, part in BY_NAME.items():
            node = tree.get(key)
            if node is not None and isinstance(node.value, str):
                tree = tree.with_value(key, _named(part, node, directory or Path(), key))
    for pattern in PATHS.get(registry.noun, ()):
        prefix = "" if registry is SCENARIOS else f"{registry.noun}."
        tree = _mapped(tree, pattern, absolute, prefix)
    return tree


def _mapped(node: Node, pattern: Sequence[str], change: Callable[[Node, str], Node], field: str) -> Node:
    """Change the nodes at the keys of `pattern`, where "*" is any index; `change` takes node and path."""
    if not pattern:
        return change(node, field.rstrip("."))
    key, *rest = pattern
    if key == "*" and isinstance(node.value, list):
        items = [_mapped(item, rest, change, f"{field}{i}.") for i, item in enumerate(node.value)]
        return replace(node, value=items)
    child = node.get(key)
    return node if child is None else node.with_value(key, _mapped(child, rest, change, f"{field}{key}."))


def _changes_a_value(override: str) -> bool:
    """Sort key: overrides that select the meaning of a section come before those of its values."""
    return override.partition("=")[0].rpartition(".")[2] not in SELECTORS


def _override(tree: Node, override: str) -> Node:
    """Apply one override ``a.b.c=value``."""
    name, equals, text = override.partition("=")
    location, keys = Location(f"--set {name}"), name.split(".")
    if not equals or not all(keys) or len(keys) > MAX_DEPTH:
        raise input_error(Location(f"--set {override}"), "expected KEY=VALUE, for example training.seed=3")
    if name == "extends":
        raise input_error(location, "belongs in a file; give the other scenario as the argument")
    value = at_location(read_text(text, location.file), location)
    return _expanded(put(tree, keys, value, location), SCENARIOS, location.file, None)


def _load_part(source: str | Path, registry: Registry[Path], model: type[P]) -> P:
    (key,) = model.model_fields
    node = _read(registry, *catalog.find(registry, str(source), Path()))
    return validate(Node({key: node}, node.location, {key: node.location}), model)


def _require_no_part(path: Path, first: Location) -> None:
    """Check that a file that is not a scenario is not a part of one.

    Raises:
        InputError: it is a vessel or a harbor.
    """
    for registry, model in ((VESSELS, _VesselFile), (HARBORS, _HarborFile)):
        with suppress(DockctlError):
            _load_part(path, registry, model)
            (part,) = model.model_fields
            message = f"a {part}, expected a scenario; use it in one with '{part}: {path.name}'"
            break
    else:
        return
    raise input_error(first, message, code="mismatch")


def _without_replaced(tree: Node, own: Sequence[Path], *, received: bool, trust: bool) -> Node:
    """Return the tree without others' plugins that the user's `own` files replace.

    Plugins that the user names with ``--set`` or lists in a scenario file do not count as others'.

    Raises:
        UntrustedError: others' plugins may not run.
    """
    listed = tree.get("plugins")
    if listed is None or not isinstance(listed.value, list):
        return tree
    if not _is_of_others(listed.location, received=received):
        return tree
    files = [node.value for node in listed.value if isinstance(node.value, str)]
    theirs = [file for file in files if os.path.exists(file)]
    kept = {*map(str, allowed(map(Path, theirs), own, trust=trust))}
    items = [node for node in listed.value if node.value not in theirs or node.value in kept]
    return tree.with_value("plugins", Node(items, listed.location))


def _is_of_others(location: Location, *, received: bool) -> bool:
    """Return whether a value is from a received file; values from the command line have no line."""
    if location.file.startswith("--set ") and not location.line:
        return False
    return received or is_received(Path(location.file))


def _load_plugins(tree: Node) -> Iterable[Problem]:
    listed = tree.get("plugins")
    for index, node in enumerate(listed.value if listed and isinstance(listed.value, list) else ()):
        if isinstance(node.value, str):
            try:
                plugins.load_file(Path(node.value))
            except DockctlError as error:
                yield node.location.problem(error.message, f"plugins.{index}", error.code, error.suggestion)
