"""One process at a time at a run."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from dockctl.errors import DockctlError
from dockctl.runs.files import writing


@contextmanager
def alone(path: Path) -> Iterator[None]:
    """Keep a file or folder to this process until the block is done, where the file system knows locks.

    Raises:
        DockctlError: another process has it, or it cannot be opened.
    """
    with writing(path):
        descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise DockctlError(f"{path}: another process is at work on this") from None
    except OSError:  # a file system without locks
        pass
    try:
        yield
    finally:
        os.close(descriptor)
