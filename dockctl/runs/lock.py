"""Locks against two processes in one run folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from dockctl.errors import DockctlError


@contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Lock a folder or a file for this process, by a lock file in the folder or next to the file.

    Read-only folders and file systems without locks are used without one.

    Raises:
        DockctlError: there is no such path, or another process holds the lock.
    """
    if not path.exists():
        raise DockctlError(f"{path}: no such file or folder", code="not_found")
    lock = FileLock(path / ".lock" if path.is_dir() else path.with_suffix(".lock"))
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise DockctlError(f"{path}: another process is using it", code="busy") from None
    except (OSError, NotImplementedError):  # no permission, or no locks
        pass
    try:
        yield
    finally:
        lock.release()
