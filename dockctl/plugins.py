"""Registries of everything that can be extended, and the plugins that add to them.

A registry maps a name to an `Entry`, which records its origin. A name cannot be registered twice, except by
running the same definition again, which replaces the entry.

Installed packages declare names through the entry-point groups in `GROUPS`; their code is imported when a
name is first used. Local ``.py`` files register when they are loaded. Code registers itself with a decorator;
a scenario, vessel or harbor is the path of a YAML file, a function that returns one, or the package that
contains ``<name>.yaml``.
"""

from __future__ import annotations

import hashlib
import importlib
import inspect
import sys
import traceback
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, cached_property, partial
from importlib.metadata import EntryPoint, entry_points
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar, cast

from dockctl.errors import (
    DockctlError,
    DuplicateNameError,
    PluginError,
    UnknownNameError,
    nearest,
    one_line,
    plugin_errors,
)
from dockctl.reading import read_bytes

T = TypeVar("T")
Function = Callable[..., Any]

PACKAGE_ORIGIN = "dockctl"
_origin: ContextVar[str | None] = ContextVar("origin", default=None)


@contextmanager
def registering_as(origin: str) -> Iterator[None]:
    """Set the origin of entries that are registered inside the block, for example ``file mine.py``."""
    token = _origin.set(origin)
    try:
        yield
    finally:
        _origin.reset(token)


def _origin_of(value: object) -> str:
    """Return the current origin; outside of `registering_as`, the module that defines `value`."""
    module = str(value.__module__) if callable(value) else PACKAGE_ORIGIN
    inside = module == PACKAGE_ORIGIN or module.startswith(f"{PACKAGE_ORIGIN}.")
    return _origin.get() or (PACKAGE_ORIGIN if inside else f"module {module}")


@dataclass(frozen=True)
class Entry(Generic[T]):
    """A registered value.

    Attributes:
        kind: group within the registry, for example when a reward term applies.
        source: equation, table, paper or data sheet.
        origin: package or file.
    """

    name: str
    value: T
    kind: str
    source: str
    origin: str

    @property
    def file(self) -> str:
        """The file of the registered code; empty if it was typed in a shell or a notebook."""
        try:
            return inspect.getfile(cast(Any, self.value))
        except (OSError, TypeError):
            return ""

    @property
    def place(self) -> str:
        """File and line where the code is defined, in parentheses; empty if its source is not available."""
        try:
            return f" ({self.file}:{inspect.getsourcelines(cast(Any, self.value))[1]})"
        except (OSError, TypeError):
            return ""

    def is_redefined_by(self, other: Entry[Any]) -> bool:
        """Return whether `other` is this definition, run again: a reload, a cell, or a plugin file."""
        first, second = (getattr(entry.value, "__qualname__", "") for entry in (self, other))
        same_module = getattr(self.value, "__module__", 1) == getattr(other.value, "__module__", 2)
        same_file = self.file and other.file and Path(self.file).resolve() == Path(other.file).resolve()
        return bool(first) and first == second and bool(same_module or same_file)

    @cached_property  # reading a signature takes longer than most observation parts
    def parameters(self) -> dict[str, Any]:
        """Keyword-only parameters of a function and their defaults, `inspect.Parameter.empty` if required."""
        if not callable(self.value):
            return {}
        if complete := getattr(self.value, "model_rebuild", None):
            complete()  # pydantic builds the signature of a model on first use
        parameters = inspect.signature(self.value).parameters.values()
        return {p.name: p.default for p in parameters if p.kind is inspect.Parameter.KEYWORD_ONLY}

    def parameter_errors(self, given: Collection[str]) -> Iterator[tuple[str, DockctlError]]:
        """Yield every unknown name among the parameters in `given` and every missing one, with its error."""
        known = self.parameters
        for name in given:
            if name not in known:
                message = f"'{self.name}' has no parameter '{name}' (known: {', '.join(known) or 'none'})"
                yield name, DockctlError(message, code="unknown_key", suggestion=nearest(name, known))
        for name, default in known.items():
            if default is inspect.Parameter.empty and name not in given:
                yield name, DockctlError(f"'{self.name}' needs the parameter '{name}'", code="missing_key")

    def bind(self, given: Mapping[str, Any]) -> Callable[..., Any]:
        """Return the registered function with the given parameters bound.

        Raises:
            DockctlError: a parameter is unknown or missing.
        """
        assert callable(self.value), f"{self.name} takes no parameters"
        for _, error in self.parameter_errors(given):
            raise error
        return partial(self.value, **given)


@dataclass(frozen=True)
class LazyEntry:
    """A name whose code is not imported yet; `load` registers it or raises an error."""

    origin: str
    load: Callable[[], None]


class Registry(Generic[T]):
    """Entries of one type by name, in the order in which they were registered."""

    def __init__(self, noun: str) -> None:
        self.noun = noun
        self._known: dict[str, Entry[T] | LazyEntry] = {}

    def register(self, name: str, value: T, *, kind: str = "", source: str = "") -> T:
        """Add `value` under `name` and return it.

        Raises:
            DuplicateNameError: the name is taken; the message names both origins.
        """
        origin = _origin_of(value)
        known, entry = self._known.get(name), Entry(name, value, kind, source, origin)
        if known and not (
            known.origin == origin if isinstance(known, LazyEntry) else known.is_redefined_by(entry)
        ):
            raise self._duplicate(name, origin)
        self._known[name] = entry
        return value

    def register_lazily(self, name: str, origin: str, load: Callable[[], None]) -> None:
        """Add `name`, which `load` registers on first use; if it is taken, first use raises the error."""
        if name in self:
            origin, load = f"{self.origin(name)} and {origin}", partial(_raise, self._duplicate(name, origin))
        self._known[name] = LazyEntry(origin, load)

    def unregister(self, origin: str) -> None:
        """Remove every entry that `origin` registered."""
        self._known = {name: known for name, known in self._known.items() if known.origin != origin}

    def save(self) -> dict[str, Entry[T] | LazyEntry]:
        """Return the current state, for `restore`."""
        return dict(self._known)

    def restore(self, state: dict[str, Entry[T] | LazyEntry]) -> None:
        """Restore a state returned by `save`."""
        self._known = dict(state)

    def __reduce__(self) -> tuple[Callable[[str], Registry[Any]], tuple[str]]:
        """Copies and pickles of a registry refer to the registry of the process."""
        return _registry_of, (self.noun,)

    def __contains__(self, name: object) -> bool:
        return name in self._known

    def __iter__(self) -> Iterator[Entry[T]]:
        """Iterate over the entries whose code is loaded; see `names` for all."""
        return iter([known for known in self._known.values() if isinstance(known, Entry)])

    def names(self) -> list[str]:
        """Return every name, including those whose code is not imported yet."""
        return list(self._known)

    def origin(self, name: str) -> str:
        """Return the origin of `name` without importing anything, or an empty string if it is unknown."""
        return self._known[name].origin if name in self._known else ""

    def get(self, name: str) -> Entry[T]:
        """Return the entry `name`, importing the plugin that declares it if necessary.

        Raises:
            UnknownNameError: it is not registered.
            DockctlError: its plugin fails.
        """
        known = self._known.get(name)
        if isinstance(known, LazyEntry):
            with registering_as(known.origin):
                known.load()
            known = self._known[name]
        if isinstance(known, Entry):
            return known
        others = sorted(self._known.keys() - {name})
        message = f"unknown {self.noun} '{name}' (known: {', '.join(others) or 'none'})"
        raise UnknownNameError(message, suggestion=nearest(name, others))

    def _duplicate(self, name: str, origin: str) -> DuplicateNameError:
        return DuplicateNameError(self.noun, name, (self.origin(name), origin))


def _registry_of(noun: str) -> Registry[Any]:
    return next(registry for registry in GROUPS.values() if registry.noun == noun)


def _raise(error: DockctlError) -> None:
    raise error


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
