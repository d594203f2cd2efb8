"""Where scenarios, vessels and harbors are found: by name in the registries, or as YAML files."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

from dockctl import plugins
from dockctl.errors import DockctlError
from dockctl.plugins import HARBORS, SCENARIOS, VESSELS, Registry

SUFFIXES = (".yaml", ".yml")
PACKAGE = Path(__file__).resolve().parent
FOLDERS: dict[str, Registry[Path]] = {".": SCENARIOS, "vessels": VESSELS, "harbors": HARBORS}


def packaged(inside: str, name: str) -> Path:
    """Return a folder of packaged YAML files, called `inside` in the wheel and `name` in the sources."""
    folder = PACKAGE / inside
    return folder if folder.is_dir() else PACKAGE.parent.parent / name


@cache
def fill() -> None:
    """Register the packaged files, then what installed packages offer."""
    for folder, registry in FOLDERS.items():
        for path in sorted((packaged("data", "scenarios") / folder).glob("*.yaml")):
            registry.register(path.stem, path)
    plugins.discover()


def find(registry: Registry[Path], text: str, directory: Path) -> tuple[Path, str]:
    """Return the file that `text` means, and how to call it in messages.

    A path (it exists as a file, or it ends in .yaml or .yml), relative to `directory`, wins over a name.

    Raises:
        DockctlError: neither a file nor a known name.
    """
    fill()
    path = directory / text
    there = _on_disk(path)
    if there and (path.is_file() or path.suffix in SUFFIXES or text not in registry):
        return path, os.path.normpath(path)
    if path.suffix in SUFFIXES:
        known = f"{registry.noun}s known by name: {', '.join(sorted(registry.names()))}"
        raise DockctlError(f"there is no file {os.path.normpath(path)}; {known}", code="not_found")
    path = Path(registry.get(text).value)
    return path, shown(path)


def _on_disk(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # too long for a file name, or holding a null byte
        return False


def shown(path: Path) -> str:
    """Return `path` as a reader wants it: relative where it lies below the working folder."""
    normal = os.path.normpath(path)
    relative = os.path.relpath(normal)
    return normal if relative.startswith("..") else relative
