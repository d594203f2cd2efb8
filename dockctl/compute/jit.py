"""Inner loops compiled by numba, cached on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

from dockctl import geometry

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(**options: Any) -> Callable[[Function], Function]:
    """Return a decorator that compiles a function, caches it on disk and releases the GIL while it runs.

    Numba recompiles a function if its own file has changed, but not if another file with a function that it
    calls has changed. The name under which it is cached therefore includes a hash of the files it may call.
    If nothing can be cached, functions are compiled in every process.

    Args:
        options: of `numba.njit`.
    """

    def decorate(function: Function) -> Function:
        function.__qualname__ += f"_{_digest(Path(function.__code__.co_filename).parent)}"
        try:
            return cast("Function", njit(cache=True, nogil=True, **options)(function))
        except RuntimeError:  # no cache folder
            return cast("Function", njit(nogil=True, **options)(function))

    return decorate


@cache
def _digest(folder: Path) -> str:
    """Hash the sources that compiled functions in a folder may call: the folder and the geometry."""
    sources = [path.read_bytes() for path in sorted(folder.glob("*.py"))]
    called = [source for source in sources if b"@compiled" in source]
    return hashlib.sha256(b"".join([*called, Path(geometry.__file__).read_bytes()])).hexdigest()[:12]
