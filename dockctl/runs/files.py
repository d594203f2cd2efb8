"""Files and folders: atomic writes that survive a power cut, locks, and checks that a path can be used."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from dockctl.errors import DockctlError


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Report an OSError in the block as a failure to write `path`.

    Raises:
        DockctlError: the block raised an OSError.
    """
    try:
        yield
    except OSError as error:
        raise DockctlError(
            f"{path}: cannot be written: {error.strerror or error}", code="not_writable"
        ) from None


def sync(path: Path) -> None:
    """Wait until the content of a file, or the names in a folder, are on disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno != errno.EINVAL:  # not supported by some file systems, for example network ones
            raise
    finally:
        os.close(descriptor)


def make_folder(path: Path) -> None:
    """Create a folder and its parents, unless they exist."""
    missing = [folder for folder in (path, *path.parents) if not os.path.exists(folder)]
    path.mkdir(parents=True, exist_ok=True)
    for folder in missing:
        sync(folder.parent)


@contextmanager
def all_or_nothing(*folders: Path) -> Iterator[list[Path]]:
    """Yield a list for new files and folders, which are removed if the block fails, as on a full disk.

    Args:
        folders: folders that contain them; those that the block creates are also removed, with parents.
    """
    missing = {each for folder in folders for each in (folder, *folder.parents) if not os.path.exists(each)}
    new: list[Path] = []
    try:
        yield new
    except BaseException:
        for path in new:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        for folder in sorted(missing, reverse=True):
            with suppress(OSError):  # another process has used it in the meantime
                folder.rmdir()
        raise


def write_atomically(path: Path, content: bytes) -> Path:
    """Write a file so that a reader sees the old or the new content, even after a crash or power cut.

    Raises:
        DockctlError: the file cannot be written.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with writing(path):
        try:
            temporary.write_bytes(content)
            sync(temporary)
            temporary.replace(path)
            sync(path.parent)
        except OSError:
            temporary.unlink(missing_ok=True)
            raise
    return path


def write_json(path: Path, value: Any) -> Path:
    """Write a JSON file atomically; see `json_text`.

    Raises:
        DockctlError: the file cannot be written.
    """
    return write_atomically(path, json_text(value).encode())


def json_text(value: Any) -> str:
    """Return plain data as JSON; NaN and infinity, which JSON does not support, become null."""
    return json.dumps(_standard(value), indent=2) + "\n"


def _standard(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _standard(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_standard(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
        make_folder(path.parent)
        new.mkdir()
        yield new
        for item in (*new.rglob("*"), new):
            sync(item)
        shutil.rmtree(old, ignore_errors=True)
        if os.path.exists(path):
            path.replace(old)
            sync(path.parent)
        new.replace(path)
        sync(path.parent)
        shutil.rmtree(old, ignore_errors=True)


def intact(path: Path) -> Path:
    """Return the folder `path`, or the previous one if `new_folder` was killed while replacing it."""
    old = path.with_name(f".{path.name}.old")
    return old if os.path.isdir(old) and not os.path.isdir(path) else path


def require_writable(root: Path) -> None:
    """Check that `root` is, or can become, a writable folder, without creating it.

    Raises:
        DockctlError: it cannot.
    """
    existing = next(path for path in (root.absolute(), *root.absolute().parents) if os.path.exists(path))
    if not os.path.isdir(existing):
        reason = f"{existing} is not a folder"
    elif not os.access(existing, os.W_OK | os.X_OK):
        reason = f"no write permission for {existing}"
    else:
        return
    raise DockctlError(f"{root}: cannot be written: {reason}", code="not_writable")


def require_writable_file(file: Path, suffix: str) -> None:
    """Check that a file can be written, before any work is done for it.

    Raises:
        DockctlError: its name has a different suffix, so that a file of another type could be replaced, its
            folder does not exist or cannot be written, or it is a folder itself.
    """
    if file.suffix != suffix:
        message = f"{file}: expected a file name that ends in {suffix}"
        raise DockctlError(message, suggestion=str(file.with_suffix(suffix)) if file.name else "")
    if not os.path.isdir(file.absolute().parent) or os.path.isdir(file):
        raise DockctlError(
            f"{file}: cannot be written: not a file name in an existing folder", code="not_writable"
        )
    with writing(file), suppress(FileNotFoundError):
        file.stat()  # fails if the name is too long
    require_writable(file.absolute().parent)


def require_replaceable(folder: Path, always: Collection[str], perhaps: Collection[str], what: str) -> None:
    """Check that `folder` can be replaced: it is new, empty, or an earlier version of the same thing.

    Args:
        folder: the folder to replace.
        always: names of the files and folders that every version contains.
        perhaps: names that a version may contain.
        what: what the folder contains, for the message.

    Raises:
        DockctlError: it cannot be written, or contains something else.
    """
    for path in (folder.resolve(), folder.resolve().parent):
        require_writable(path)
    with writing(folder):
        names = {path.name for path in folder.iterdir()} if os.path.isdir(folder) else set()
    if names and not {*always} <= names <= {*always, *perhaps}:
        raise DockctlError(
            f"{folder}: is not empty and contains no {what}; choose a new folder", code="not_writable"
        )


@contextmanager
def exclusive_lock(path: Path) -> Iterator[None]:
    """Lock a folder or a file for this process, with a lock file in the folder or next to the file.

    Read-only folders and file systems without locks are not locked.

    Raises:
        DockctlError: there is no such path, or another process holds the lock.
    """
    from filelock import FileLock, Timeout  # takes a while, and most commands need no lock

    if not path.exists():
        raise DockctlError(f"{path}: no such file or folder", code="not_found")
    lock = FileLock(path / ".lock" if path.is_dir() else path.with_suffix(".lock"))
    try:
        lock.acquire(blocking=False)
    except Timeout:
        raise DockctlError(f"{path}: another process is using it", code="busy") from None
    except (OSError, NotImplementedError):  # no permission, or a file system without locks
        pass
    try:
        yield
    finally:
        lock.release()


def is_locked(folder: Path) -> bool:
    """Return whether a process holds the lock of a folder."""
    if not os.path.exists(folder / ".lock"):
        return False
    try:
        with exclusive_lock(folder):
            return False
    except DockctlError:
        return True
