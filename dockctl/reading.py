"""Read untrusted files, which may be damaged or crafted to exhaust memory, within limits."""

from __future__ import annotations

import csv
import gzip
import io
import json
import math
import os
import stat
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dockctl.errors import Code, DockctlError

MAX_BYTES = 64_000_000
MAX_VALUES = 10_000_000
"""Maximum number of values in a table or a JSON file; each takes up to about 100 bytes of memory."""
MAX_DEPTH = 50
FOREIGN = (
    ArithmeticError,
    AttributeError,
    EOFError,
    LookupError,
    OSError,
    RecursionError,
    StopIteration,
    TypeError,
    ValueError,
    csv.Error,
    zlib.error,
)
"""Exceptions that parsers raise for files with unexpected content."""


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Report the exceptions that a missing, truncated or foreign file causes as a failure to read `path`.

    Raises:
        DockctlError: the block raised one of them.
    """
    try:
        yield
    except FOREIGN as error:
        reason = f"{error} is missing" if isinstance(error, KeyError) else error
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise DockctlError(f"{path}: cannot be read: {reason}", code=code) from None


def read_limited(path: Path, max_bytes: int) -> bytes:
    """Return the content of a regular file of at most `max_bytes`; never waits for a pipe or a device.

    Raises:
        DockctlError: it is not such a file or cannot be read; the message is the reason, without the path.
    """
    try:
        file = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY)
        try:
            status = os.fstat(file)
            if not stat.S_ISREG(status.st_mode):
                what = "a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file"
                raise DockctlError(f"is {what}", code="not_readable")
            size = status.st_size
            with os.fdopen(file, "rb", closefd=False) as stream:
                data = stream.read(size + 1) if size <= max_bytes else b""
        finally:
            os.close(file)
    except (OSError, ValueError) as error:  # ValueError: a null byte in the path
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise DockctlError(f"cannot be read: {getattr(error, 'strerror', error)}", code=code) from None
    if size > max_bytes:
        message = f"is larger than {max_bytes / 1e6:g} MB, the limit for such a file"
        raise DockctlError(message, code="out_of_range")
    if len(data) > size:  # for example kernel files, whose size is 0
        raise DockctlError("changes while it is being read", code="not_readable")
    return data


def read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Read a regular file of at most `limit` bytes; one whose name ends in ``.gz`` is decompressed.

    Raises:
        DockctlError: the file is missing, larger, damaged, or not a regular file.
    """
    try:
        content = read_limited(path, limit)
    except DockctlError as error:
        raise DockctlError(f"{path}: {error.message}", code=error.code) from None
    if path.suffix == ".gz":
        with reading(path), gzip.open(io.BytesIO(content)) as file:
            content = file.read(limit + 1)
        if len(content) > limit:
            message = f"{path}: is larger than {limit / 1e6:g} MB when decompressed"
            raise DockctlError(message, code="out_of_range")
    return content


def read_json(path: Path) -> Any:
    """Read a JSON file of limited size and depth, without NaN and infinity.

    Raises:
        DockctlError: the file is missing, larger, or not such a file.
    """
    content = read_bytes(path)
    with reading(path):
        return parse_json(content.decode("utf-8"))


def parse_json(text: str) -> Any:
    """Parse JSON of limited size and depth, without NaN and infinity.

    Raises:
        ValueError, RecursionError: the text is not such JSON.
    """
    if sum(map(text.count, ",[{")) > MAX_VALUES:
        raise ValueError(f"contains more than {MAX_VALUES:,} values")
    value = json.loads(text, parse_float=_finite, parse_constant=_finite)
    level: list[Any] = [value]
    for _ in range(MAX_DEPTH):
        level = [child for item in level for child in _children(item) if isinstance(child, dict | list)]
    if level:
        raise ValueError(f"nested more than {MAX_DEPTH} levels deep")
    return value


def _children(item: Any) -> Any:
    return item.values() if isinstance(item, dict) else item if isinstance(item, list) else ()


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise ValueError(f"contains {text}, which is not a finite number")
    return number
