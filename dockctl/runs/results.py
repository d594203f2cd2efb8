"""Results of a command: files, and a JSON file, written last, that contains their hashes.

By the hashes, a reader detects files that are incomplete, stale, or from a different result.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from dockctl.errors import DockctlError
from dockctl.reading import read_bytes
from dockctl.run_files import BEST, LAST, POLICY_JSON
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import write_atomically, write_json

MAX_STEM = 150
FILES = "files"
"""Key of the hashes: SHA-256 by path relative to the JSON file."""


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file.

    Raises:
        DockctlError: it cannot be read.
    """
    return hashlib.sha256(read_bytes(path)).hexdigest()


def hashes_of(paths: Iterable[Path]) -> dict[Path, str]:
    """Return the SHA-256 of each of the files that exist.

    Raises:
        DockctlError: a file cannot be read.
    """
    return {path: sha256_of(path) for path in paths if os.path.isfile(path)}


def write_results(path: Path, facts: Mapping[str, Any], hashes: Mapping[Path, str]) -> Path:
    """Write a JSON file with `facts` and the hashes of the files that belong to them.

    Raises:
        DockctlError: it cannot be written.
    """
    files = {os.path.relpath(file, path.parent): digest for file, digest in hashes.items()}
    return write_json(path, {**facts, FILES: files})


def write_measurement(stem: Path, table: str, facts: Mapping[str, Any]) -> tuple[Path, Path]:
    """Write ``<stem>.csv``, then ``<stem>.json`` with the facts, and return both paths.

    Raises:
        DockctlError: a file cannot be written.
    """
    content = table.encode()
    csv = write_atomically(Path(f"{stem}.csv"), content)
    return csv, write_results(Path(f"{stem}.json"), facts, {csv: hashlib.sha256(content).hexdigest()})


def read_results(path: Path) -> dict[str, Any]:
    """Return the content of a JSON file of results, after checking the files that belong to it.

    Raises:
        DockctlError: a file is missing or damaged, or belongs to other results.
    """
    facts = RunDirectory(path.parent).read_json(path.name)
    files = facts.get(FILES)
    if not isinstance(files, dict):
        raise DockctlError(f"{path}: '{FILES}' is missing: run the command again", code="missing_key")
    for name, digest in files.items():
        file = path.parent / name
        if sha256_of(file) != digest:
            message = f"{file}: damaged, or does not belong to {path.name}: run the command again"
            raise DockctlError(message, code="mismatch")
    return facts


def file_stem(names: Sequence[str], overrides: Sequence[str]) -> str:
    """Return a file name, without suffix, of some names and changed values of a scenario, ``key=value``.

    A long one is cut off and ends with a hash of the whole.
    """
    stem = "-".join([*names, *(re.sub(r"[^\w.=-]+", "_", override) for override in overrides)])
    if len(stem) <= MAX_STEM:
        return stem
    digest = hashlib.sha256("\n".join([*names, *overrides]).encode()).hexdigest()[:8]
    return f"{stem[: MAX_STEM - len(digest) - 1]}-{digest}"


def result_stem(measurement: str, scenario: str = "", overrides: Sequence[str] = ()) -> str:
    """Return the file name, without suffix, of a measurement of a policy.

    Args:
        measurement: a name in `dockctl.run_files`.
        scenario: its name, unless it is the policy's own and unchanged.
        overrides: changed values of the scenario, ``key=value``.
    """
    return file_stem([measurement, *filter(None, [scenario])], overrides)


def require_same_policy(path: Path, policy: Mapping[str, Any]) -> None:
    """Check that a JSON file of results, if it exists, is of this policy and may be replaced.

    Raises:
        DockctlError: it is of a different policy.
    """
    if not os.path.isfile(path):
        return
    other = RunDirectory(path.parent).read_json(path.name).get("policy")
    if isinstance(other, dict) and not any(
        key in other and other[key] == policy.get(key) for key in ("name", "file", "sha256")
    ):
        raise DockctlError(f"{path}: results of a different policy: choose another folder", code="mismatch")


def policy_hash(facts: Mapping[str, Any]) -> str | None:
    """Return the SHA-256 of the policy that the facts name, if any."""
    policy = facts.get("policy")
    return policy.get("sha256") if isinstance(policy, dict) else None


def measured_policy(run: Path) -> str | None:
    """Return the SHA-256 of the policy that is measured: the best, or the last if there is no best."""
    for name in (BEST, LAST):
        try:
            return str(RunDirectory(RunDirectory(run).checkpoint(name)).read_json(POLICY_JSON)["sha256"])
        except (DockctlError, KeyError):
            pass
    return None


def is_outdated(run: Path, name: str) -> bool:
    """Return whether the results in a JSON file of a run are of an earlier policy, before further training.

    Raises:
        DockctlError: the file is damaged.
    """
    if not (run / name).exists():
        return False
    found = policy_hash(RunDirectory(run).read_json(name))
    current = measured_policy(run)
    return None not in (found, current) and found != current
