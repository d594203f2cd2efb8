"""Provenance of a run: code, seed, libraries, machine, command line."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

import dockctl

LIBRARIES = (
    "torch", "numpy", "numba", "gymnasium", "pydantic", "trimesh", "python-fcl", "safetensors", "scipy",
)  # fmt: skip


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
        "started": now(),
        "finished": None,
        "stop_reason": None,
    }


def git_commit() -> str | None:
    """Return the commit of the checkout that dockctl runs from, with ``+`` if files were changed, or None."""
    root = Path(dockctl.__file__).parent.parent
    if not (root / ".git").exists():
        return None
    try:
        git = ["git", "-C", str(root)]
        commit = subprocess.run(
            [*git, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=5, check=True
        )
        changed = subprocess.run(
            [*git, "status", "--porcelain", "-uno"], capture_output=True, text=True, timeout=5
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return commit.stdout.strip() + ("+" if changed.stdout.strip() else "")


def hardware() -> dict[str, Any]:
    """Return platform, processor, number of cores and byte order of the machine."""
    return {
        "platform": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
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
