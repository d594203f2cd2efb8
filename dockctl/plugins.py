"""Bring in what others contribute: entry points of installed packages, and local ``.py`` files.

A package offers names through the groups of `GROUPS`. The object of a reward term or an observation part
registers itself with its decorator when its module is imported; a scenario, vessel or harbor is the path of
a YAML file, a function that returns one, or the package that holds ``<name>.yaml``.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
import traceback
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

from dockctl.errors import DockctlError
from dockctl.registry import (
    HARBORS,
    OBSERVATION_PARTS,
    REWARD_TERMS,
    SCENARIOS,
    VESSELS,
    Registry,
    contributing,
)

FUNCTIONS: dict[str, Registry[Any]] = {
    "dockctl.rewards": REWARD_TERMS,
    "dockctl.observations": OBSERVATION_PARTS,
}
DATA: dict[str, Registry[Path]] = {
    "dockctl.scenarios": SCENARIOS,
    "dockctl.vessels": VESSELS,
    "dockctl.harbors": HARBORS,
}
GROUPS: dict[str, Registry[Any]] = {**FUNCTIONS, **DATA}
BUILTINS = ("dockctl.rewards.terms", "dockctl.envs.observation")

_loaded: dict[str, str] = {}
"""Content hash of every local file in use, with its origin."""


class PluginError(DockctlError):
    """A plugin that cannot be used; the text names it and says why."""


@cache
def load_builtins() -> None:
    """Import the package's own reward terms and observation parts, by name, as the layers ask."""
    for module in BUILTINS:
        importlib.import_module(module)


@cache
def discover() -> None:
    """Offer what installed packages contribute, without importing any of it."""
    load_builtins()
    for group, registry in GROUPS.items():
        for point in entry_points(group=group):
            if not _registered_already(point, registry):
                load = partial(_load_function if group in FUNCTIONS else _load_data, point, registry)
                registry.offer(point.name, _origin(point), load)


def load_file(path: Path) -> None:
    """Run the local plugin at `path`; the same content is run once, and an edited file replaces itself.

    Raises:
        PluginError: it is missing, not a ``.py`` file, or fails to import.
        DuplicateNameError: it registers a name that somebody else registered.
    """
    if path.suffix != ".py":
        raise PluginError(f"plugin {path} is not a .py file")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PluginError(f"plugin {path} cannot be read: {error.strerror or error}") from None
    digest = hashlib.sha256(content).hexdigest()
    if digest in _loaded:
        return
    origin = f"file {path}"
    _forget(origin)
    with contributing(origin):
        try:
            _run(f"_dockctl_plugin_{digest[:16]}", path, content)
        except (Exception, SystemExit) as error:  # a plugin may raise anything while it is imported
            _forget(origin)
            raise _failure(f"plugin {path}", error, path) from error
    _loaded[digest] = origin


def _run(name: str, path: Path, content: bytes) -> None:
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses and pickles look their module up
    exec(compile(content, path, "exec"), module.__dict__)


def _forget(origin: str) -> None:
    for registry in GROUPS.values():
        registry.withdraw(origin)
    for digest in [digest for digest, known in _loaded.items() if known == origin]:
        del _loaded[digest]


def _origin(point: EntryPoint) -> str:
    return f"package {point.dist.name} {point.dist.version}" if point.dist else f"entry point {point.value}"


def _registered_already(point: EntryPoint, registry: Registry[Any]) -> bool:
    """Whether the object of `point` registered itself because somebody imported its module before us."""
    value = getattr(sys.modules.get(point.module), point.attr, None)
    return any(entry.name == point.name and entry.value is value for entry in registry)


def _load_function(point: EntryPoint, registry: Registry[Any]) -> None:
    _import(point)
    if not any(entry.name == point.name for entry in registry):
        message = f"{point.value} does not register the {registry.noun} '{point.name}'"
        raise PluginError(f"{_origin(point)}: {message}")


def _load_data(point: EntryPoint, registry: Registry[Path]) -> None:
    value = _import(point)
    if isinstance(value, ModuleType):
        value = Path(str(files(value) / f"{point.name}.yaml"))
    elif callable(value):
        value = value()
    if not isinstance(value, str | Path):
        raise PluginError(f"{_origin(point)}: {point.value} is not the path of a YAML file")
    registry.register(point.name, Path(value))


def _import(point: EntryPoint) -> Any:
    before = set(sys.modules)
    try:
        return point.load()
    except (Exception, SystemExit) as error:  # a plugin may raise anything while it is imported
        for name in set(sys.modules) - before:
            if name == point.module:
                del sys.modules[name]
        _forget(_origin(point))
        raise _failure(_origin(point), error, None) from error


def _failure(who: str, error: BaseException, path: Path | None) -> DockctlError:
    """Name the plugin, the reason, and the line of the plugin's own code."""
    if isinstance(error, DockctlError):
        return error
    if isinstance(error, SyntaxError):
        line, reason = error.lineno, f"SyntaxError: {error.msg}"
    else:
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        line, reason = (frames[-1].lineno if frames else None), f"{type(error).__name__}: {error}"
    place = f" (line {line})" if line else ""
    return PluginError(f"{who} fails to import: {reason}{place}")
