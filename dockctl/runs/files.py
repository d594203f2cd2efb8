"""Files that are whole or not there, and one way to tell that they cannot be read or written."""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dockctl.errors import DockctlError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tell the user when the system refuses to write `path`.

    Raises:
        DockctlError: the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        raise DockctlError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Tell the user that `path` is missing, or does not hold what the block looks for.

    Raises:
        DockctlError: the block raised what a missing, torn or foreign file leads to.
    """
    try:
        yield
    except (OSError, EOFError, zlib.error, KeyError, TypeError, ValueError) as error:
        reason = f"it lacks {error}" if isinstance(error, KeyError) else error
        raise DockctlError(f"{path}: cannot be read: {reason}") from None


def write_atomically(path: Path, content: bytes) -> Path:
    """Write a file so that a reader or a crash sees the old one or the new one, whole.

    Raises:
        DockctlError: the place cannot be written to.
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
    """Give an empty folder that takes the place of `path`, and of all that is in it, when the block is done.

    Raises:
        DockctlError: the place cannot be written to.
    """
    new, old = (path.with_name(f".{path.name}.{which}") for which in ("new", "old"))
    with writing(path):
        if standing(path) == old:
            old.replace(path)
        shutil.rmtree(new, ignore_errors=True)
        new.mkdir(parents=True)
        yield new
        shutil.rmtree(old, ignore_errors=True)
        if os.path.exists(path):
            path.replace(old)
        new.replace(path)
        shutil.rmtree(old, ignore_errors=True)


def standing(path: Path) -> Path:
    """The folder `path`, or the one before it, moved aside, where `new_folder` was killed in between."""
    old = path.with_name(f".{path.name}.old")
    return old if os.path.isdir(old) and not os.path.isdir(path) else path
