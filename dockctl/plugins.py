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
from collections.abc import Iterator
from contextlib import contextmanager
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
    with contributing(origin), _all_or_nothing(f"plugin {path}", path):
        for registry in GROUPS.values():
            registry.withdraw(origin)
        _run(f"_dockctl_plugin_{digest[:16]}", path, content)
    for known in [known for known, bringer in _loaded.items() if bringer == origin]:
        del _loaded[known]
    _loaded[digest] = origin


def _run(name: str, path: Path, content: bytes) -> None:
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module  # dataclasses and pickles look their module up
    exec(compile(content, path, "exec"), module.__dict__)


@contextmanager
def _all_or_nothing(who: str, path: Path | None = None) -> Iterator[None]:
    """Undo what a plugin registered if it fails, and say which plugin failed, why, and in which line."""
    saved = [(registry, registry.save()) for registry in GROUPS.values()]
    try:
        yield
    except (Exception, SystemExit) as error:  # a plugin may raise anything while it is imported
        for registry, state in saved:
            registry.restore(state)
        if isinstance(error, DockctlError):
            raise
        reason = f"{type(error).__name__}: {getattr(error, 'msg', error)}"
        raise PluginError(f"{who} fails to import: {reason}{_place(error, path)}") from error


def _place(error: BaseException, path: Path | None) -> str:
    """Return where a plugin failed: in the file `path`, else in the last module that is not Python's own."""
    if isinstance(error, SyntaxError) and error.lineno:
        return f" ({error.filename}:{error.lineno})"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if "importlib" not in frame.filename and frame.filename != __file__
    ]
    own = [frame for frame in frames if frame.filename == str(path)] or frames
    return f" ({own[-1].filename}:{own[-1].lineno})" if own else ""


def _origin(point: EntryPoint) -> str:
    return f"package {point.dist.name} {point.dist.version}" if point.dist else f"entry point {point.value}"


def _registered_already(point: EntryPoint, registry: Registry[Any]) -> bool:
    """Whether the object of `point` registered itself because somebody imported its module before us."""
    module, _, name = point.value.partition(":")
    value = getattr(sys.modules.get(module), name, None)
    return value is not None and any(entry.name == point.name and entry.value is value for entry in registry)


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
        with _all_or_nothing(_origin(point)):
            value = value()
    if not isinstance(value, str | Path):
        raise PluginError(f"{_origin(point)}: {point.value} is not the path of a YAML file")
    registry.register(point.name, Path(value))


def _import(point: EntryPoint) -> Any:
    with _all_or_nothing(_origin(point)):
        return point.load()
