"""Named things that the package, installed plugins and local files contribute.

A registry maps a name to an `Entry`. Who contributes is told by `contributing`, so that every
entry knows its origin and a name registered twice is refused with both origins in the message.
Installed plugins only offer their names; their code is imported when a name is first used.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from dockctl.errors import DockctlError, nearest

T = TypeVar("T")

PACKAGE_ORIGIN = "dockctl"
_origin: ContextVar[str | None] = ContextVar("origin", default=None)


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


def _origin_of(value: object) -> str:
    """Return who contributes now; outside of `contributing`, the module that `value` was written in."""
    module = str(value.__module__) if callable(value) else PACKAGE_ORIGIN
    inside = module == PACKAGE_ORIGIN or module.startswith(f"{PACKAGE_ORIGIN}.")
    return _origin.get() or (PACKAGE_ORIGIN if inside else f"module {module}")


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
        """Keyword-only parameters of a function and their defaults, `inspect.Parameter.empty` if none."""
        if not callable(self.value):
            return {}
        signature = inspect.signature(self.value)
        return {
            name: parameter.default
            for name, parameter in signature.parameters.items()
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY
        }

    def bound(self, given: Mapping[str, Any]) -> Callable[..., Any]:
        """Return the registered function with the parameters `given` filled in.

        Raises:
            DockctlError: a parameter is unknown or missing.
        """
        assert callable(self.value), f"{self.name} takes no parameters"
        known = self.parameters
        for name in given:
            if name not in known:
                listed = ", ".join(known) or "none"
                raise DockctlError(
                    f"'{self.name}' has no parameter '{name}'{nearest(name, known)} (known: {listed})"
                )
        for name, default in known.items():
            if default is inspect.Parameter.empty and name not in given:
                raise DockctlError(f"'{self.name}' needs the parameter '{name}'")
        return partial(self.value, **given)


@dataclass(frozen=True)
class Offer:
    """A name whose code is not imported yet; `load` registers it or says why it cannot."""

    origin: str
    load: Callable[[], None]


class Registry(Generic[T]):
    """Entries of one sort, by name, in the order in which they were registered."""

    def __init__(self, noun: str) -> None:
        self.noun = noun
        self._entries: dict[str, Entry[T]] = {}
        self._offers: dict[str, Offer] = {}

    def register(self, name: str, value: T, *, kind: str = "", source: str = "") -> T:
        """Add `value` under `name` and return it.

        Raises:
            DuplicateNameError: the name is taken; the message names both origins.
        """
        origin = _origin_of(value)
        offer = self._offers.get(name)
        if name in self._entries or (offer and offer.origin != origin):
            raise self._duplicate(name, origin)
        self._offers.pop(name, None)
        self._entries[name] = Entry(name, value, kind, source, origin)
        return value

    def offer(self, name: str, origin: str, load: Callable[[], None]) -> None:
        """Promise `name`, for `load` to register on its first use; one that is taken is refused then."""
        if name in self:
            origin, load = f"{self.origin(name)} and {origin}", _raising(self._duplicate(name, origin))
            self._entries.pop(name, None)
        self._offers[name] = Offer(origin, load)

    def withdraw(self, origin: str) -> None:
        """Forget every entry that `origin` registered."""
        self._entries = {name: entry for name, entry in self._entries.items() if entry.origin != origin}

    def save(self) -> tuple[dict[str, Entry[T]], dict[str, Offer]]:
        """Return the present state, for `restore`."""
        return dict(self._entries), dict(self._offers)

    def restore(self, state: tuple[dict[str, Entry[T]], dict[str, Offer]]) -> None:
        """Go back to a state that `save` gave."""
        self._entries, self._offers = dict(state[0]), dict(state[1])

    def __contains__(self, name: object) -> bool:
        return name in self._entries or name in self._offers

    def __iter__(self) -> Iterator[Entry[T]]:
        """Iterate over the entries whose code is loaded; see `names` for all."""
        return iter(tuple(self._entries.values()))

    def names(self) -> list[str]:
        """Return every name, also those whose code is not imported yet."""
        return [*self._entries, *self._offers]

    def origin(self, name: str) -> str:
        """Return who brings `name`, without importing anything; empty where nobody does."""
        known = self._entries.get(name) or self._offers.get(name)
        return known.origin if known else ""

    def get(self, name: str) -> Entry[T]:
        """Return the entry called `name`, importing the plugin that offers it if need be.

        Raises:
            UnknownNameError: nobody registered it; the message lists what exists and the nearest name.
            DockctlError: the plugin that offers it cannot be used.
        """
        if offer := self._offers.get(name):
            with contributing(offer.origin):
                offer.load()
        try:
            return self._entries[name]
        except KeyError:
            raise UnknownNameError(self.unknown(name)) from None

    def unknown(self, name: str) -> str:
        """Say that `name` is unknown, what exists, and the nearest match."""
        known = [known for known in self.names() if known != name]
        listed = ", ".join(sorted(known)) or "none"
        return f"unknown {self.noun} '{name}'{nearest(name, known)} (known: {listed})"

    def _duplicate(self, name: str, origin: str) -> DuplicateNameError:
        return DuplicateNameError(
            f"{self.noun} '{name}' is registered twice: by {self.origin(name)} and by {origin}; rename one"
        )


def _raising(error: DockctlError) -> Callable[[], None]:
    def refuse() -> None:
        raise error

    return refuse


Function = Callable[..., Any]

REWARD_TERMS: Registry[Function] = Registry("reward term")
OBSERVATION_PARTS: Registry[Function] = Registry("observation part")
SCENARIOS: Registry[Path] = Registry("scenario")
VESSELS: Registry[Path] = Registry("vessel")
HARBORS: Registry[Path] = Registry("harbor")
