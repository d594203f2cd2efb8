"""A model of a disk and of power cuts: what was not synced may be lost, emptied or filled with NUL bytes.

It takes only what POSIX guarantees: `fsync` of a file keeps its content, `fsync` of a folder the names in it.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

Image = frozenset[tuple[str, bytes | None]]
"""Relative path and content of every file; None for folders."""


class Disk:
    """Watches a folder and collects what it may contain after a power cut before any change of it.

    Attributes:
        images: the different contents, each with the value of `mark` at the latest cut that leaves it.
        mark: set it to what has returned so far.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.images: dict[Image, Any] = {}
        self.mark: Any = None
        self.cuts = 0
        self._content: dict[int, bytes] = {}
        self._names: dict[int, dict[str, int]] = {}
        self._folders: set[int] = set()
        self._held: list[int] = []  # open files, so that no inode number is used again
        for path in (root, *root.rglob("*")):
            self._sync(path)

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Collect the images of the block."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "fsync", self._fsync)
            for name in ("replace", "rename", "unlink", "remove", "mkdir", "rmdir"):
                patch.setattr(os, name, self._before(getattr(os, name)))
            yield
            self._cut()
        for descriptor in self._held:
            os.close(descriptor)

    def _before(self, change: Callable[..., None]) -> Callable[..., None]:
        def changed(*given: Any, **named: Any) -> None:
            self._cut()
            change(*given, **named)

        return changed

    def _fsync(self, descriptor: int) -> None:
        self._cut()
        self._sync(Path(f"/proc/self/fd/{descriptor}"))

    def _sync(self, path: Path) -> None:
        status = self._hold(path)
        if stat.S_ISDIR(status.st_mode):
            self._names[status.st_ino] = {entry.name: self._hold(entry).st_ino for entry in path.iterdir()}
        else:
            self._content[status.st_ino] = path.read_bytes()

    def _hold(self, path: Path) -> os.stat_result:
        self._held.append(os.open(path, os.O_RDONLY))
        status = os.fstat(self._held[-1])
        if stat.S_ISDIR(status.st_mode):
            self._folders.add(status.st_ino)
        return status

    def _cut(self) -> None:
        self.cuts += 1
        now = {path: path.stat() for path in (self.root, *self.root.rglob("*"))}
        synced = dict(self._durable(self.root.stat().st_ino, ""))
        killed, emptied, zeroed = (
            dict[str, bytes | None](),
            dict[str, bytes | None](),
            dict[str, bytes | None](),
        )
        for path, status in now.items():
            name = path.relative_to(self.root).as_posix()
            if path.is_dir():
                killed[name] = emptied[name] = zeroed[name] = None
            else:
                killed[name] = path.read_bytes()
                emptied[name] = self._content.get(status.st_ino, b"")
                zeroed[name] = emptied[name].ljust(status.st_size, b"\0")
        for image in (synced, killed, emptied, zeroed):
            self.images[frozenset(image.items())] = self.mark

    def _durable(self, folder: int, path: str) -> Iterator[tuple[str, bytes | None]]:
        yield path or ".", None
        for name, inode in self._names.get(folder, {}).items():
            inner = f"{path}/{name}" if path else name
            if inode in self._content:
                yield inner, self._content[inode]
            elif inode in self._names:
                yield from self._durable(inode, inner)
            else:
                yield inner, None if inode in self._folders else b""

    def restore(self, image: Image, folder: Path) -> Path:
        """Write an image into a new folder."""
        for name, content in sorted(image, key=lambda item: item[0]):
            if content is None:
                (folder / name).mkdir(parents=True, exist_ok=True)
            else:
                (folder / name).write_bytes(content)
        return folder
