"""Tables that take seconds to build, kept in the user's cache folder under a hash of what they depend on."""

from __future__ import annotations

import hashlib
import logging
import os
import tempfile
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

KEPT_FILES = 24
log = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Return the folder of cached tables: under XDG_CACHE_HOME, or ``~/.cache``.

    Raises:
        RuntimeError: the user has no home.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "dockctl"


def cached(name: str, ingredients: Iterable[bytes], build: Callable[[], Arrays]) -> Arrays:
    """Return the arrays that `build` makes, from the cache if they were made before.

    Several processes may do this at once: a file appears whole or not at all, and a damaged one is made anew.
    Where nothing can be written, the arrays are made each time.

    Args:
        name: what the tables are, for the file's name and for the log.
        ingredients: all that the arrays depend on, the code included.
        build: makes the arrays.
    """
    digest = hashlib.sha256()
    for ingredient in ingredients:
        digest.update(hashlib.sha256(ingredient).digest())
    try:
        path = cache_folder() / f"{name.replace(' ', '-')}-{digest.hexdigest()[:24]}.npz"
    except RuntimeError:
        return build()
    try:
        with np.load(path) as stored:
            arrays = dict(stored)
        os.utime(path)
        return arrays
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        log.info("building the table of the %s (some seconds, once)", name)
    arrays = build()
    try:
        _write(path, arrays)
    except OSError as error:
        log.info("the table of the %s cannot be kept: %s", name, error)
    return arrays


def _write(path: Path, arrays: Arrays) -> None:
    """Write the file whole, then forget those that have not been used for longest."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        Path(part).replace(path)
    finally:
        Path(part).unlink(missing_ok=True)
    files = sorted(path.parent.glob("*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
    for old in files[KEPT_FILES:]:
        old.unlink(missing_ok=True)
