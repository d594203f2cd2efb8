"""Cached tables: arrays that take seconds to compute, stored in the user's cache folder by content hash."""

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
import platformdirs
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

MAX_FILES = 24
log = logging.getLogger(__name__)


def cache_folder() -> Path:
    """Return the folder of cached tables; ``XDG_CACHE_HOME`` moves it."""
    return platformdirs.user_cache_path("dockctl")


def cached(name: str, inputs: Iterable[bytes], build: Callable[[], Arrays]) -> Arrays:
    """Return the arrays that `build` computes, from the cache if possible.

    Safe to call from several processes: files are written atomically, and a damaged file is rebuilt. If the
    cache cannot be written, the arrays are computed every time.

    Args:
        name: what the tables are, for the file's name and the log.
        inputs: everything that the arrays depend on, including the code.
        build: computes the arrays.
    """
    digest = hashlib.sha256()
    for data in inputs:
        digest.update(hashlib.sha256(data).digest())
    path = cache_folder() / f"{name.replace(' ', '-')}-{digest.hexdigest()[:24]}.npz"
    if not path.is_absolute():  # the user has no home directory
        return build()
    try:
        with np.load(path) as stored:
            arrays = dict(stored)
        os.utime(path)
        return arrays
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        log.info("building the %s table (once, a few seconds)", name)
    arrays = build()
    try:
        _write(path, arrays)
    except OSError as error:
        log.info("the %s table cannot be cached: %s", name, error)
    return arrays


def _write(path: Path, arrays: Arrays) -> None:
    """Write the file atomically, then delete the least recently used ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
        Path(part).replace(path)
    finally:
        Path(part).unlink(missing_ok=True)
    files = sorted(path.parent.glob("*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
    for old in files[MAX_FILES:]:
        old.unlink(missing_ok=True)
