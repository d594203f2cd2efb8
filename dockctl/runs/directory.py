"""Run folders: opening, reading and writing them. `dockctl.run_files` names and describes their files."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import dockctl
from dockctl.errors import DockctlError
from dockctl.reading import read_json
from dockctl.run_files import (
    BEST,
    CHECKPOINTS,
    LAST,
    POLICY_JSON,
    PROVENANCE,
    RUNS,
    SCENARIO,
    generations,
    run_name,
)
from dockctl.runs.files import exclusive_lock, make_folder, new_folder, sync, write_atomically, write_json
from dockctl.runs.tables import Table, TableObserver
from dockctl.scenarios.catalog import DEFAULT_SCENARIO

SHIPPED = Path(dockctl.__file__).parent / "checkpoints"
"""Folder of the checkpoints that come with the package."""


def shipped() -> dict[str, Path]:
    """Return the folder of each checkpoint that comes with the package, by name."""
    return {file.parent.name: file.parent for file in sorted(SHIPPED.glob(f"*/{POLICY_JSON}"))}


def default_policy(scenario: str | None = None) -> RunDirectory | str:
    """Return the latest run in ./runs, or if there is none the name of a shipped policy.

    Args:
        scenario: the scenario that it will run in; its shipped policy is preferred to the default one.
    """
    try:
        return RunDirectory.latest(RUNS)
    except DockctlError:
        return scenario if scenario in shipped() else DEFAULT_SCENARIO


def named_checkpoints() -> dict[str, Path]:
    """Return the folder of each checkpoint that has a name: the shipped ones, then those in ./checkpoints."""
    own = {file.parent.name: file.parent for file in sorted(Path(CHECKPOINTS).glob(f"*/{POLICY_JSON}"))}
    return shipped() | {name: folder for name, folder in own.items() if name not in shipped()}


class RunDirectory:
    """One training run on disk. Files are replaced atomically; tables grow by complete rows.

    Attributes:
        observer: receives the rows of the tables that are opened after it is set.
    """

    observer: TableObserver | None = None

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(cls, root: Path, scenario_name: str, seed: int) -> RunDirectory:
        """Create a new folder under `root`; an existing one is never touched.

        Raises:
            DockctlError: the folder cannot be created or written.
        """
        stem = run_name(f"{datetime.now(UTC):%Y%m%d-%H%M%S}", seed)
        try:
            parent = root / scenario_name
            make_folder(parent)
            for attempt in range(1, 1000):
                path = parent / (stem if attempt == 1 else f"{stem}-{attempt}")
                try:
                    path.mkdir()
                except FileExistsError:
                    continue
                sync(parent)
                return cls(path)
        except OSError as error:
            raise DockctlError(
                f"{root}: cannot be written: {error.strerror or error}", code="not_writable"
            ) from None
        raise DockctlError(
            f"{parent / stem}: a thousand runs were started in the same second", code="not_writable"
        )

    @classmethod
    def open(cls, path: Path) -> RunDirectory:
        """Open an existing run folder.

        Raises:
            DockctlError: there is no such folder, or it contains no run.
        """
        if not os.path.isdir(path):
            raise DockctlError(f"{path}: no such run folder", code="not_found")
        if not os.path.isfile(path / SCENARIO):
            message = (
                f"{path}: not a run folder (it has no {SCENARIO}); dockctl train creates one under {RUNS}/"
            )
            raise DockctlError(message, code="not_found")
        return cls(path)

    @classmethod
    def latest(cls, root: Path, *, unsaved: bool = False) -> RunDirectory:
        """Return the most recently started run under `root`, at any depth, that has a checkpoint.

        Args:
            unsaved: also consider runs that have no checkpoint yet.

        Raises:
            DockctlError: there is none.
        """
        runs = [run for run in cls.below(root) if unsaved or any(map(run.checkpoints, (BEST, LAST)))]
        if not runs:
            message = (
                f"{root}: no run{'' if unsaved else ' with a checkpoint'} yet; train one with: dockctl train"
            )
            raise DockctlError(message, code="not_found")
        return max(runs, key=lambda run: (run.sequence, run.path.name))

    @classmethod
    def latest_interrupted(cls, root: Path) -> RunDirectory:
        """Return the most recently started run under `root` that can be resumed and is not running.

        Raises:
            DockctlError: there is none.
        """
        runs = (run for run in cls.below(root) if run.checkpoints(LAST) and not run.is_finished)
        for run in sorted(runs, key=lambda run: (run.sequence, run.path.name), reverse=True):
            with suppress(DockctlError), exclusive_lock(run.path):
                return run
        raise DockctlError(f"{root}: no interrupted run; give one with --resume RUN", code="not_found")

    @property
    def is_finished(self) -> bool:
        """Whether training has ended and is complete."""
        try:
            return self.read_json(PROVENANCE).get("finished") is not None
        except DockctlError:
            return False

    @classmethod
    def next_sequence(cls, root: Path) -> int:
        """Return the number of a new run under `root`, which orders runs independently of the clock.

        All runs in `RUNS` share one sequence, including those of sweeps in subfolders.
        """
        top = RUNS if root.resolve().is_relative_to(RUNS.resolve()) else root
        return 1 + max((run.sequence for run in cls.below(top)), default=0)

    @classmethod
    def below(cls, root: Path) -> Iterator[RunDirectory]:
        """Yield the runs at any depth below a folder, sorted by path; links to folders are not followed."""
        for folder, names, files in os.walk(root):
            if SCENARIO in files and PROVENANCE in files:
                names.clear()
                yield cls(Path(folder))
            names.sort()

    @property
    def sequence(self) -> int:
        """Number of the run in the order of starts; 0 if unknown."""
        try:
            number = self.read_json(PROVENANCE).get("sequence")
        except DockctlError:
            return 0
        return number if isinstance(number, int) else 0

    @classmethod
    def containing(cls, checkpoint: Path) -> RunDirectory | None:
        """Return the run of the file ``<run>/checkpoints/<name>/<file>``, or None if it is not in a run."""
        path = checkpoint.absolute().parent.parent.parent
        return cls(path) if os.path.isfile(path / SCENARIO) else None

    def checkpoint(self, name: str) -> Path:
        """Return the newest folder of the checkpoint `name`, `BEST` or `LAST`, whether it exists or not."""
        return next(iter(self.checkpoints(name)), self._generations(name)[0])

    def checkpoints(self, name: str) -> list[Path]:
        """Return the folders of the checkpoint `name`, the newest first."""
        return [folder for folder in self._generations(name) if os.path.isdir(folder)]

    @contextmanager
    def new_checkpoint(self, name: str) -> Iterator[Path]:
        """Yield an empty folder, which becomes the newest checkpoint `name` when the block ends.

        Raises:
            DockctlError: the folder cannot be written.
        """
        places = self._generations(name)
        with new_folder(places[0]) as folder:
            yield folder
            kept = self.checkpoints(name)
            gap = next((i for i, place in enumerate(places) if place not in kept), len(places) - 1)
            shutil.rmtree(places[gap], ignore_errors=True)
            for newer, older in reversed([*pairwise(places[: gap + 1])]):
                newer.replace(older)
                sync(newer.parent)

    def _generations(self, name: str) -> list[Path]:
        return [self.path / CHECKPOINTS / each for each in generations(name)]

    def table(self, name: str, columns: Iterable[str]) -> Table:
        """Return the table `name`, to append rows."""
        return Table(self.path / name, columns, self.observer)

    def inside(self, path: str) -> str:
        """Return the path relative to the run folder; unchanged for a file outside it."""
        home = self.path.resolve()
        return Path(path).relative_to(home).as_posix() if Path(path).is_relative_to(home) else path

    def write_text(self, name: str, text: str) -> Path:
        """Write a text file of the run.

        Raises:
            DockctlError: it cannot be written.
        """
        return write_atomically(self.path / name, text.encode())

    def write_json(self, name: str, value: Any) -> Path:
        """Write a JSON file of the run.

        Raises:
            DockctlError: it cannot be written.
        """
        return write_json(self.path / name, value)

    def read_json(self, name: str) -> dict[str, Any]:
        """Read a JSON object of the run.

        Raises:
            DockctlError: it is missing or damaged.
        """
        value = read_json(self.path / name)
        if not isinstance(value, dict):
            message = f"{self.path / name}: cannot be read: expected a JSON object"
            raise DockctlError(message, code="not_readable")
        return value

    def copy_files(self, folder: str, files: Iterable[Path]) -> dict[str, str]:
        """Copy files into a folder of the run and return the SHA-256 of each by its path in the run.

        Raises:
            DockctlError: a copy cannot be written.
        """
        hashes = {}
        for number, file in enumerate(files):
            content = file.read_bytes()
            name = f"{folder}/{number:02d}-{file.name}"
            make_folder(self.path / folder)
            write_atomically(self.path / name, content)
            hashes[name] = hashlib.sha256(content).hexdigest()
        return hashes
