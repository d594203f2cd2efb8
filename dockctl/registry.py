"""Named things that the package, installed plugins and local files contribute.

A registry maps a name to an `Entry`. Who contributes is told by `contributing`, so that every
entry knows its origin and a name registered twice is refused with both origins in the message.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from dockctl.errors import DockctlError, nearest

T = TypeVar("T")

PACKAGE_ORIGIN = "dockctl"
_origin: ContextVar[str] = ContextVar("origin", default=PACKAGE_ORIGIN)


class DuplicateNameError(DockctlError):
    """Two contributors registered the same name."""


class UnknownNameError(DockctlError):
    """A name that no contributor registered."""


@contextmanager
def contributing(origin: str) -> Iterator[None]:
    """Name whoever registers entries inside the block, for example ``file rewards/mine.py``."""
    token = _origin.set(origin)
    try:
        yield
    finally:
        _origin.reset(token)


@dataclass(frozen=True)
class Entry(Generic[T]):
    """A registered thing: its name, what kind it is, the equation it comes from, and who brought it."""

    name: str
    value: T
    kind: str
    source: str
    origin: str

    @property
    def parameters(self) -> dict[str, Any]:
        """Keyword-only parameters of a registered function and their defaults (`inspect.Parameter.empty` if none)."""
        if not callable(self.value):
            return {}
        signature = inspect.signature(self.value)
        return {
            name: parameter.default
            for name, parameter in signature.parameters.items()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        }


class Registry(Generic[T]):
    """Entries of one sort, by name, in the order in which they were registered."""

    def __init__(self, noun: str) -> None:
        self.noun = noun
        self._entries: dict[str, Entry[T]] = {}

    def register(self, name: str, value: T, *, kind: str = "", source: str = "") -> T:
        """Add `value` under `name` and return it.

        Raises:
            DuplicateNameError: the name is taken; the message names both origins.
        """
        origin = _origin.get()
        if name in self._entries:
            raise DuplicateNameError(
                f"{self.noun} '{name}' is registered twice: by {self._entries[name].origin} and by {origin}; rename one"
            )
        self._entries[name] = Entry(name, value, kind, source, origin)
        return value

    def remove(self, name: str) -> None:
        """Forget `name`; a name that is not there is left alone."""
        self._entries.pop(name, None)

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[Entry[T]]:
        return iter(tuple(self._entries.values()))

    def names(self) -> list[str]:
        return list(self._entries)

    def get(self, name: str) -> Entry[T]:
        """Return the entry called `name`.

        Raises:
            UnknownNameError: nobody registered it; the message lists what exists and the nearest name.
        """
        try:
            return self._entries[name]
        except KeyError:
            raise UnknownNameError(self.unknown(name)) from None

    def unknown(self, name: str) -> str:
        """Say that `name` is unknown, what exists, and the nearest match."""
        known = self.names()
        return f"unknown {self.noun} '{name}'{nearest(name, known)} (known: {', '.join(sorted(known)) or 'none'})"


Function = Callable[..., Any]

REWARD_TERMS: Registry[Function] = Registry("reward term")
OBSERVATION_PARTS: Registry[Function] = Registry("observation part")
SCENARIOS: Registry[Any] = Registry("scenario")
VESSELS: Registry[Any] = Registry("vessel")
HARBORS: Registry[Any] = Registry("harbor")
