"""Atomic writes, and one way to report that a file cannot be read or written."""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dockctl.errors import Code, DockctlError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Report an OSError of the block as a failure to write `path`.

    Raises:
        DockctlError: the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        raise DockctlError(
            f"{path}: cannot be written: {error.strerror or error}", code="not_writable"
        ) from None


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Report the exceptions that a missing, truncated or foreign file causes as a failure to read `path`.

    Raises:
        DockctlError: the block raised one of them.
    """
    try:
        yield
    except (OSError, EOFError, zlib.error, KeyError, TypeError, ValueError) as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise DockctlError(f"{path}: cannot be read: {reason}", code=code) from None


def write_atomically(path: Path, content: bytes) -> Path:
    """Write a file so that a reader sees the old or the new content, also after a crash.

    Raises:
        DockctlError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with writing(path):
        try:
            temporary.write_bytes(content)
            temporary.replace(path)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
    return path


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield an empty folder that replaces the folder `path` when the block ends without an exception.

    Raises:
        DockctlError: the folder cannot be written.
    """
    new, old = (path.with_name(f".{path.name}.{which}") for which in ("new", "old"))
    with writing(path):
        if intact(path) == old:
            old.replace(path)
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir(parents=True)
        yield new
        shutil.rmtree(old, ignore_errors=True)
        if os.path.exists(path):
            path.replace(old)
        new.replace(path)
        shutil.rmtree(old, ignore_errors=True)


def intact(path: Path) -> Path:
    """Return the folder `path`, or the previous one if `new_folder` was killed while replacing it."""
    old = path.with_name(f".{path.name}.old")
    return old if os.path.isdir(old) and not os.path.isdir(path) else path
