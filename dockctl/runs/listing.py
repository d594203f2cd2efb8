"""The runs below a folder, with their state and progress."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dockctl.errors import DockctlError
from dockctl.reading import read_bytes
from dockctl.run_files import EPISODES_CSV, EVALUATION, EVALUATIONS_CSV, PROVENANCE, TIMING_CSV
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import is_locked
from dockctl.runs.results import is_outdated
from dockctl.runs.tables import MAX_TABLE_BYTES, START_KEYS

TRAINING, FINISHED, INTERRUPTED, DIVERGED, DAMAGED = (
    "training", "finished", "interrupted", "diverged", "damaged"
)  # fmt: skip


@dataclass(frozen=True)
class RunSummary:
    """A run in a list.

    Attributes:
        name: name given by the user, or an empty string.
        state: training, finished, interrupted, diverged or damaged.
        env_steps: environment steps at the last evaluation or at the end of the last training episode.
        success: success rate of the current policy in ``dockctl evaluate``, else in the last validation.
        measured: where `success` is from, ``evaluation`` or ``validation``; empty if there is none.
        size: total size of the files [bytes].
    """

    path: Path
    name: str
    scenario: str
    seed: int | None
    state: str
    env_steps: int | None
    success: float | None
    measured: str
    tags: tuple[str, ...]
    size: int

    def to_json(self) -> dict[str, Any]:
        """Return the summary as plain data."""
        return {**vars(self), "path": str(self.path), "tags": list(self.tags)}


def summarize(run: RunDirectory) -> RunSummary:
    """Describe a run; damaged files are described as such."""
    facts = _facts(run)
    seed, tags = facts.get("seed"), facts.get("tags")
    success, measured = _success(run)
    latest = (rows[-1] for table in (TIMING_CSV, EPISODES_CSV) if (rows := _last_rows(run, table)))
    steps = [count for row in latest if (count := _whole(row.get("env_steps"))) is not None]
    return RunSummary(
        path=run.path,
        name=given_name(run),
        scenario=run.path.parent.name,
        seed=seed if isinstance(seed, int) else None,
        state=state_of(run),
        env_steps=max(steps, default=None),
        success=success,
        measured=measured,
        tags=tuple(map(str, tags)) if isinstance(tags, list) else (),
        size=size_of(run.path),
    )


def state_of(run: RunDirectory) -> str:
    """Return training, finished, interrupted, diverged or damaged."""
    if is_locked(run.path):
        return TRAINING
    facts = _facts(run)
    if not facts:
        return DAMAGED
    if facts.get("stop_reason") == DIVERGED:
        return DIVERGED
    return FINISHED if facts.get("finished") else INTERRUPTED


def given_name(run: RunDirectory) -> str:
    """Return the name given with ``dockctl train --name``, or an empty string."""
    name = _facts(run).get("name")
    return name if isinstance(name, str) else ""


def _facts(run: RunDirectory) -> dict[str, Any]:
    try:
        return run.read_json(PROVENANCE)
    except DockctlError:
        return {}


def size_of(path: Path) -> int:
    """Return the size of a file or folder [bytes]; files that disappear meanwhile are ignored."""
    total = path.lstat().st_size if path.is_file() else 0
    for folder, _, files in os.walk(path):
        for file in files:
            try:
                total += os.lstat(os.path.join(folder, file)).st_size  # noqa: PTH118 - thousands of blocks
            except OSError:
                continue
    return total


def _success(run: RunDirectory) -> tuple[float | None, str]:
    try:
        facts = {} if is_outdated(run.path, f"{EVALUATION}.json") else run.read_json(f"{EVALUATION}.json")
        for kind in ("random", "held_out", "pose"):
            rate = facts.get(START_KEYS[kind], {}).get("success")
            if isinstance(rate, int | float):
                return float(rate), "evaluation"
    except (DockctlError, AttributeError):
        pass
    rows = _last_rows(run, EVALUATIONS_CSV)
    validation = [row for row in rows if row.get("start_kind") == "validation"]
    if not validation:
        return None, ""
    final = [row for row in validation if row.get("env_steps") == validation[-1].get("env_steps")]
    return sum(row.get("outcome") == "docked" for row in final) / len(final), "validation"


def _last_rows(run: RunDirectory, name: str) -> list[dict[str, str | None]]:
    """Return the rows of a table; none if it is missing or damaged."""
    try:
        text = read_bytes(run.path / name, MAX_TABLE_BYTES).decode()
        return list(csv.DictReader(text.splitlines()))
    except (DockctlError, UnicodeDecodeError, csv.Error):
        return []


def _whole(text: str | None) -> int | None:
    return int(text) if text and text.isdecimal() and len(text) <= 18 else None
