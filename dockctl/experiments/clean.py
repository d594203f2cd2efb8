"""Find what can be deleted from the runs below a folder."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dockctl.agents.checkpoint import load_policy
from dockctl.agents.training_state import load_state, unused_blocks
from dockctl.errors import DockctlError
from dockctl.run_files import BEST, LAST
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import exclusive_lock, is_locked, writing
from dockctl.runs.listing import DIVERGED, FINISHED, INTERRUPTED, size_of, state_of


@dataclass(frozen=True)
class Garbage:
    """What can be deleted from one run, and why; `size` in bytes."""

    run: Path
    paths: tuple[Path, ...]
    reason: str
    size: int

    def to_json(self) -> dict[str, Any]:
        """Return plain data."""
        return {**vars(self), "run": str(self.run), "paths": [*map(str, self.paths)]}


def garbage_below(root: Path) -> Iterator[Garbage]:
    """Yield what can be deleted from the runs in a folder and its subfolders, except those in use.

    An unfinished run without checkpoints can be deleted entirely: it can be neither resumed nor evaluated. (A
    finished run without checkpoints, as in the archive of a study, has results.) Of a finished run with
    checkpoints, the older ones, which are backups, can be deleted if the newest are intact.
    """
    for run in RunDirectory.below(root):
        if is_locked(run.path):
            continue
        best, last, state = run.checkpoints(BEST), run.checkpoints(LAST), state_of(run)
        if not best and not last and state in (INTERRUPTED, DIVERGED):
            yield Garbage(run.path, (run.path,), "no checkpoint", size_of(run.path))
        elif (best[1:] or last[1:]) and state == FINISHED and _newest_are_intact(run):
            paths = (*best[1:], *last[1:], *unused_blocks(run, last[:1]))
            yield Garbage(run.path, paths, "older checkpoints", sum(map(size_of, paths)))


def delete(garbage: Garbage) -> None:
    """Delete what can be deleted from a run, unless a process has started to use it.

    Raises:
        DockctlError: the run is in use, or cannot be deleted.
    """
    with exclusive_lock(garbage.run), writing(garbage.run):
        for path in garbage.paths:
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink(missing_ok=True)


def _newest_are_intact(run: RunDirectory) -> bool:
    try:
        for folder in run.checkpoints(BEST)[:1]:
            load_policy(folder)
        return not run.checkpoints(LAST) or not load_state(run).damaged
    except DockctlError:
        return False
