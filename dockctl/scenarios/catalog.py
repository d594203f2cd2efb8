"""Find scenarios, vessels and harbors: by registered name, or by the path of a YAML file."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from dockctl import plugins
from dockctl.errors import DockctlError
from dockctl.plugins import HARBORS, SCENARIOS, VESSELS
from dockctl.registry import Registry

SUFFIXES = (".yaml", ".yml")
DEFAULT_SCENARIO = "s3"
"""Scenario that commands use if none is given."""
PACKAGE = Path(__file__).resolve().parent
FOLDERS: dict[str, Registry[Path]] = {".": SCENARIOS, "vessels": VESSELS, "harbors": HARBORS}


def packaged_folder(inside: str, name: str) -> Path:
    """Return a folder of packaged YAML files: `inside` of an installed package, `name` of a checkout."""
    folder = PACKAGE / inside
    return folder if folder.is_dir() else PACKAGE.parent.parent / name


@cache
def fill() -> None:
    """Register the packaged files and the plugins of installed packages."""
    for folder, registry in FOLDERS.items():
        for path in sorted((packaged_folder("data", "scenarios") / folder).glob("*.yaml")):
            registry.register(path.stem, path)
    plugins.discover()


def find(registry: Registry[Path], text: str, directory: Path) -> tuple[Path, str]:
    """Return the file that `text` refers to, and its path for messages.

    A path, which exists or ends in .yaml or .yml, takes precedence over a registered name. It is relative to
    `directory`.

    Raises:
        DockctlError: neither a file nor a registered name.
    """
    fill()
    path = directory / text
    exists = _exists(path)
    if exists and (path.is_file() or path.suffix in SUFFIXES or text not in registry):
        if path.is_dir():
            message = f"'{text}' is a directory, expected a YAML file or the name of a {registry.noun}"
            raise DockctlError(message, code="not_readable")
        return path, os.path.normpath(path)
    if path.suffix in SUFFIXES:
        known = f"known {registry.noun}s: {', '.join(sorted(registry.names()))}"
        raise DockctlError(f"no such file: {os.path.normpath(path)} ({known})", code="not_found")
    path = Path(registry.get(text).value)
    return path, display_path(path)


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long for a file name, or with a null byte
        return False


def display_path(path: Path) -> str:
    """Return `path` for messages: relative if it is below the working directory, otherwise unchanged."""
    normal = os.path.normpath(path)
    try:
        relative = os.path.relpath(normal)
    except FileNotFoundError:  # the working directory was replaced, by a recording of the same name
        return normal
    return normal if relative.startswith("..") else relative
