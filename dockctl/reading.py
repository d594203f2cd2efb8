"""Read files that others wrote: regular files only, up to a size."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from dockctl.errors import Code, DockctlError


def read_limited(path: Path, max_bytes: int) -> bytes:
    """Return the content of a regular file of at most `max_bytes`; never waits for a pipe or a device.

    Raises:
        DockctlError: it is something else, or cannot be read; the message is the reason, without the path.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        try:
            status = os.fstat(file)
            if not stat.S_ISREG(status.st_mode):
                what = "a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file"
                raise DockctlError(f"is {what}", code="not_readable")
            with os.fdopen(file, "rb", closefd=False) as stream:
                data = stream.read(max_bytes + 1) if status.st_size <= max_bytes else b""
        finally:
            os.close(file)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise DockctlError(f"cannot be read: {getattr(error, 'strerror', error)}", code=code) from None
    if max(status.st_size, len(data)) > max_bytes:
        size = f"{max_bytes / 1e6:g} MB"
        raise DockctlError(f"is larger than {size}, the limit of such a file", code="out_of_range")
    return data
