"""A registry: values by name, each with its origin, some of them imported on first use.

A name cannot be registered twice, except by running the same definition again, which replaces the entry.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from dockctl.errors import DockctlError, DuplicateNameError, UnknownNameError, nearest

T = TypeVar("T")

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


def _raise(error: DockctlError) -> None:
    raise error
