"""Registries of everything that can be extended, and the plugins that add to them.

Installed packages declare names through the entry-point groups in `GROUPS`; their code is imported when a
name is first used. Local ``.py`` files register when they are loaded. Code registers itself with a decorator;
a scenario, vessel or harbor is the path of a YAML file, a function that returns one, or the package that
contains ``<name>.yaml``.
"""

from __future__ import annotations

import copyreg
import hashlib
import importlib
import sys
import traceback
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache, partial
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any

from dockctl.errors import DockctlError, PluginError, one_line, plugin_errors
from dockctl.reading import read_bytes
from dockctl.registry import PACKAGE_ORIGIN, Registry, registering_as

Function = Callable[..., Any]

REWARD_TERMS: Registry[Function] = Registry("reward term")
OBSERVATION_PARTS: Registry[Function] = Registry("observation part")
POLICIES: Registry[Function] = Registry("policy")
ACTIONS: Registry[type[Any]] = Registry("action type")
ALGORITHMS: Registry[type[Any]] = Registry("algorithm")
CONDITIONS: Registry[type[Any]] = Registry("condition")
RANGE_SENSORS: Registry[type[Any]] = Registry("range sensor")
SCENARIOS: Registry[Path] = Registry("scenario")
VESSELS: Registry[Path] = Registry("vessel")
HARBORS: Registry[Path] = Registry("harbor")

CODE: dict[str, Registry[Any]] = {
    "dockctl.rewards": REWARD_TERMS,
    "dockctl.observations": OBSERVATION_PARTS,
    "dockctl.policies": POLICIES,
    "dockctl.actions": ACTIONS,
    "dockctl.algorithms": ALGORITHMS,
    "dockctl.conditions": CONDITIONS,
    "dockctl.sensors": RANGE_SENSORS,
}
"""Registries of code: functions with keyword-only parameters, or models of sections selected by `kind`."""
DATA: dict[str, Registry[Path]] = {
    "dockctl.scenarios": SCENARIOS,
    "dockctl.vessels": VESSELS,
    "dockctl.harbors": HARBORS,
}
"""Registries of YAML files."""
GROUPS: dict[str, Registry[Any]] = {**CODE, **DATA}


def _registry_of(noun: str) -> Registry[Any]:
    return next(registry for registry in GROUPS.values() if registry.noun == noun)


# Copies and pickles of a registry refer to the registry of the process.
copyreg.pickle(Registry, lambda registry: (_registry_of, (registry.noun,)))

BUILTINS = (
    "dockctl.rewards.terms",
    "dockctl.envs.actions",
    "dockctl.envs.observation",
    "dockctl.sim.lidar.spinning",
    "dockctl.sim.lidar.planar",
    "dockctl.sim.conditions.current",
    "dockctl.sim.conditions.wind",
    "dockctl.sim.conditions.actuators",
    "dockctl.sim.conditions.navigation",
    "dockctl.sim.conditions.lidar_noise",
    "dockctl.sim.conditions.lidar_faults",
    "dockctl.sim.conditions.uncertainty",
    "dockctl.sim.conditions.shallow_water",
    "dockctl.agents.algorithms",
)
"""Modules that register the package's own entries; add a line for each new module."""

_loaded: dict[str, str] = {}
"""Hash of the content of every loaded local file, by its origin."""


@cache
def load_builtins() -> None:
    """Import the modules in `BUILTINS`, by name because they are in layers above this one."""
    for module in BUILTINS:
        importlib.import_module(module)


@cache
def discover() -> None:
    """Add the names that installed packages declare, without importing the packages."""
    load_builtins()
    declared = entry_points()  # of all groups: each call reads the metadata of every installed package
    for group, registry in GROUPS.items():
        for point in declared.select(group=group):
            if not _registered_already(point, registry):
                load = partial(_load_code if group in CODE else _load_data, point, registry)
                registry.register_lazily(point.name, _entry_point_origin(point), load)


def policy(name: str, *, source: str = "") -> Callable[[Function], Function]:
    """Register the function below under a name that commands accept as POLICY.

    The function takes a `Scenario` and keyword parameters, and returns a `dockctl.agents.interface.Policy`.
    """
    return lambda function: POLICIES.register(name, function, source=source)


def load_file(path: Path) -> ModuleType:
    """Load the local plugin at `path`, once per content; an edited file replaces its earlier registrations.

    Returns:
        The module.

    Raises:
        PluginError: the file is missing, is not a ``.py`` file, or fails to import.
        DuplicateNameError: it registers a name that another origin registered.
    """
    if path.suffix != ".py":
        raise PluginError(f"plugin {path} is not a .py file")
    try:
        content = read_bytes(path)
    except DockctlError as error:
        raise PluginError(f"plugin {error.message}") from None
    digest = hashlib.sha256(content).hexdigest()
    name = f"_dockctl_plugin_{digest[:16]}"
    if digest in _loaded.values():
        return sys.modules[name]
    origin = f"file {path}"
    with registering_as(origin), _rollback_on_error(f"plugin {path}", path):
        for registry in GROUPS.values():
            registry.unregister(origin)
        module = ModuleType(name)
        module.__file__ = str(path)
        sys.modules[name] = module  # dataclasses and pydantic look up the module
        # Not with the __future__ imports of this module, which postpone annotations and their errors.
        exec(compile(content, path, "exec", dont_inherit=True), module.__dict__)
    _loaded[origin] = digest
    return module


@contextmanager
def _rollback_on_error(who: str, path: Path | None = None) -> Iterator[None]:
    """Undo what a plugin registered if it fails, and report the plugin, the reason and the line."""
    saved = [(registry, registry.save()) for registry in GROUPS.values()]
    try:
        with plugin_errors(f"{who} fails to import", path):
            yield
        for registry, state in saved:
            for entry in registry:
                if state.get(entry.name) is not entry and hasattr(entry.value, "model_rebuild"):
                    with Guard(registry, entry.name):
                        _evaluate_annotations(entry.value)
    except DockctlError:
        for registry, state in saved:
            registry.restore(state)
        raise


def _evaluate_annotations(model: Any) -> None:
    """Complete a pydantic model, whose annotations may be postponed, with the names of its module."""
    model.model_rebuild(_types_namespace=vars(sys.modules[model.__module__]))


class Guard(AbstractContextManager["Guard"]):
    """Context in which an exception in an entry's code becomes a `PluginError` with the line that failed.

    Errors of the package's own entries, and errors that a plugin raises for the user, pass through.
    """

    def __init__(self, registry: Registry[Any], name: str) -> None:
        self._registry, self._name = registry, name

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, Exception | SystemExit) and (located := self.locate(error)) is not error:
            raise located from error

    def locate(self, error: Exception | SystemExit) -> BaseException:
        """Return the error to raise instead of `error`."""
        entry = self._registry.get(self._name)
        if entry.origin == PACKAGE_ORIGIN or (isinstance(error, DockctlError) and error.code != "plugin"):
            return error
        what = f"{entry.origin}: {self._registry.noun} '{self._name}'"
        if isinstance(error, DockctlError):
            return error if isinstance(error, PluginError) else PluginError(f"{error}{entry.place}")
        own = [f for f in traceback.extract_tb(error.__traceback__) if f.filename == entry.file]
        place = f" ({own[-1].filename}:{own[-1].lineno})" if own else entry.place
        return PluginError(f"{what} fails: {one_line(error)}{place}")


def runtime_error(error: Exception) -> PluginError | None:
    """Return the error of the plugin whose code raised `error`; None if dockctl itself failed."""
    entries = [entry for registry in CODE.values() for entry in registry if entry.origin != PACKAGE_ORIGIN]
    origins = {entry.value.__module__: entry.origin for entry in entries}
    for frame, line in reversed([*traceback.walk_tb(error.__traceback__)]):
        if origin := origins.get(frame.f_globals.get("__name__", "")):
            what = f"{origin}: {frame.f_code.co_name} fails: {one_line(error)}"
            return PluginError(f"{what} ({frame.f_code.co_filename}:{line})")
    return None


def _entry_point_origin(point: EntryPoint) -> str:
    return f"package {point.dist.name} {point.dist.version}" if point.dist else f"entry point {point.value}"


def _registered_already(point: EntryPoint, registry: Registry[Any]) -> bool:
    """Return whether the object of `point` is already registered because its module was imported."""
    module, _, name = point.value.partition(":")
    value = getattr(sys.modules.get(module), name, None)
    return value is not None and any(entry.name == point.name and entry.value is value for entry in registry)


def _load_code(point: EntryPoint, registry: Registry[Any]) -> None:
    _import(point)
    if not any(entry.name == point.name for entry in registry):
        message = f"{point.value} does not register the {registry.noun} '{point.name}'"
        raise PluginError(f"{_entry_point_origin(point)}: {message}")


def _load_data(point: EntryPoint, registry: Registry[Path]) -> None:
    value = _import(point)
    if isinstance(value, ModuleType):
        value = Path(str(files(value) / f"{point.name}.yaml"))
    elif callable(value):
        with _rollback_on_error(_entry_point_origin(point)):
            value = value()
    if not isinstance(value, str | Path):
        raise PluginError(f"{_entry_point_origin(point)}: {point.value} is not the path of a YAML file")
    registry.register(point.name, Path(value))


def _import(point: EntryPoint) -> Any:
    with _rollback_on_error(_entry_point_origin(point)):
        return point.load()
