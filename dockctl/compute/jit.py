"""Inner loops compiled by numba, and kept on disk for the next time."""

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
    """Return a decorator that compiles a function, which then lets go of Python's lock.

    Numba takes what it kept to be stale when the function's own file has changed, not when that of a function
    that is called has; the name under which it is kept therefore tells of all the compiled files beside it.
    Where nothing can be kept, functions are compiled each time.

    Args:
        options: of `numba.njit`.
    """

    def compile_one(function: Function) -> Function:
        function.__qualname__ += f"_{_digest(Path(function.__code__.co_filename).parent)}"
        try:
            return cast("Function", njit(cache=True, nogil=True, **options)(function))
        except RuntimeError:  # there is no folder to keep it in
            return cast("Function", njit(nogil=True, **options)(function))

    return compile_one


@cache
def _digest(folder: Path) -> str:
    """Hash the sources that compiled functions in a folder may call: the folder and the geometry."""
    sources = [path.read_bytes() for path in sorted(folder.glob("*.py"))]
    called = [source for source in sources if b"@compiled" in source]
    return hashlib.sha256(b"".join([*called, Path(geometry.__file__).read_bytes()])).hexdigest()[:12]
