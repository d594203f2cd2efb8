"""Provenance of a run: code, seed, libraries, machine, command line."""

from __future__ import annotations

import hashlib
import platform
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import psutil

import dockctl
from dockctl.compute import usable_cores
from dockctl.plugins import GROUPS

LIBRARIES = (
    "torch", "numpy", "numba", "gymnasium", "pydantic", "trimesh", "python-fcl", "safetensors", "scipy",
)  # fmt: skip

CONDITIONS = ("dockctl", "git_commit", "python", "libraries", "packages", "plugins", "hardware")
"""Keys of the provenance that the results of a run may depend on, apart from its scenario."""


def now() -> str:
    """Return the time in UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def collect(seed: int, command: Sequence[str]) -> dict[str, Any]:
    """Return the contents of ``provenance.json`` at the start of a run."""
    return {
        "dockctl": dockctl.__version__,
        "git_commit": git_commit(),
        "seed": seed,
        "command": list(command),
        "python": platform.python_version(),
        "libraries": {name: version for name in LIBRARIES if (version := _version(name))},
        "hardware": hardware(),
        "packages": packages(),
        "started": now(),
        "finished": None,
        "stop_reason": None,
    }


def git_commit() -> str | None:
    """Return the commit of the checkout that dockctl runs from, with ``+`` if files were changed, or None."""
    root = Path(dockctl.__file__).parent.parent
    if not (root / ".git").exists():
        return None
    words = ["git", "-C", str(root), "describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*"]
    try:
        described = subprocess.run(words, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return described.stdout.strip()


def packages() -> dict[str, dict[str, str]]:
    """Return version and content hash of each installed package whose plugins are loaded."""
    found: dict[str, dict[str, str]] = {}
    declared = entry_points()
    for group, registry in GROUPS.items():
        loaded = {entry.name for entry in registry}
        for point in declared.select(group=group):
            if point.dist is None or point.name not in loaded or point.dist.name in found:
                continue
            spec = find_spec(point.module.partition(".")[0])
            if spec is None or spec.origin is None:
                continue
            file = Path(spec.origin)
            digest = _tree_hash(file.parent if spec.submodule_search_locations else file)
            found[point.dist.name] = {"version": point.dist.version, "sha256": digest}
    return found


def _tree_hash(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of all files of a package."""
    digest, files = hashlib.sha256(), sorted(path.rglob("*")) if path.is_dir() else [path]
    for file in files:
        if file.is_file() and file.suffix != ".pyc":
            digest.update(f"{file.relative_to(path.parent).as_posix()}\0".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


def hardware() -> dict[str, Any]:
    """Return platform, processor, cores of the machine, cores that this process may use, and byte order."""
    return {
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": psutil.cpu_count(),
        "usable_cores": usable_cores(),
        "byte_order": sys.byteorder,
    }


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def _version(library: str) -> str | None:
    try:
        return metadata.version(library)
    except metadata.PackageNotFoundError:
        return None
