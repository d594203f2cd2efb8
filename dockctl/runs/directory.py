"""Run folders: ``runs/<scenario>/<timestamp>-seed<N>/`` and what lies in them."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Collection, Iterable
from contextlib import AbstractContextManager
from datetime import datetime
from pathlib import Path
from typing import Any

from dockctl.errors import DockctlError
from dockctl.runs.files import new_folder, reading, standing, write_atomically, writing
from dockctl.runs.tables import Table, cut_table

SCENARIO = "scenario.yaml"
PROVENANCE = "provenance.json"


def require_writable(root: Path) -> None:
    """Check that `root` is, or can become, a folder to write to, without making any.

    Raises:
        DockctlError: they cannot.
    """
    existing = next(path for path in (root.absolute(), *root.absolute().parents) if os.path.exists(path))
    if not os.path.isdir(existing):
        raise DockctlError(f"{root}: cannot write here: {existing} is not a folder")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise DockctlError(f"{root}: cannot write here: no right to write in {existing}")


def require_replaceable(folder: Path, always: Collection[str], perhaps: Collection[str], what: str) -> None:
    """Check that `folder` can be written as a whole, and that nothing but an earlier one of its sort is lost.

    Args:
        always, perhaps: names of the files and folders in it.
        what: it is, in words.

    Raises:
        DockctlError: it cannot be written, or holds something else.
    """
    for place in (folder.resolve(), folder.resolve().parent):
        require_writable(place)
    with writing(folder):
        there = {path.name for path in folder.iterdir()} if os.path.isdir(folder) else set()
    if there and not {*always} <= there <= {*always, *perhaps}:
        raise DockctlError(f"{folder}: is not empty and holds no {what}; give a new folder")


class RunDirectory:
    """One training run on disk. Files are replaced whole; tables grow by whole rows.

    Layout: ``scenario.yaml`` (fully resolved), ``provenance.json``, ``scene.json`` (plan view), ``plugins/``,
    ``meshes/``, ``episodes.csv``, ``updates.csv``, ``evaluations.csv``, ``timing.csv``, ``trajectories.csv``,
    ``checkpoints/best`` and ``checkpoints/last``, ``figures/``.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    @classmethod
    def create(cls, root: Path, scenario_name: str, seed: int) -> RunDirectory:
        """Make a new folder under `root`; one that exists is never touched.

        Raises:
            DockctlError: the folder cannot be made or written to.
        """
        stem = f"{datetime.now():%Y%m%d-%H%M%S}-seed{seed}"
        try:
            parent = root / scenario_name
            parent.mkdir(parents=True, exist_ok=True)
            for attempt in range(1, 1000):
                path = parent / (stem if attempt == 1 else f"{stem}-{attempt}")
                try:
                    path.mkdir()
                except FileExistsError:
                    continue
                return cls(path)
        except OSError as error:
            raise DockctlError(f"{root}: cannot write here: {error.strerror or error}") from None
        raise DockctlError(f"{parent / stem}: a thousand runs began in the same second")

    @classmethod
    def open(cls, path: Path) -> RunDirectory:
        """Open an existing run folder.

        Raises:
            DockctlError: there is no such folder, or it holds no run.
        """
        if not os.path.isdir(path):
            raise DockctlError(f"{path}: no such run folder")
        if not os.path.isfile(path / SCENARIO):
            raise DockctlError(f"{path}: not a run folder: it holds no {SCENARIO}")
        return cls(path)

    @classmethod
    def latest(cls, root: Path) -> RunDirectory:
        """The run under `root` that began last.

        Raises:
            DockctlError: there is none.
        """
        runs = [scenario.parent for scenario in root.glob(f"*/*/{SCENARIO}")]
        if not runs:
            raise DockctlError(f"{root}: no runs here yet; train one with: dockctl train")
        return cls(max(runs, key=lambda path: (path.name, path.stat().st_mtime_ns)))

    @classmethod
    def holding(cls, checkpoint: Path) -> RunDirectory | None:
        """The run of the file ``<run>/checkpoints/<name>/<file>``, or None where it lies elsewhere."""
        path = checkpoint.absolute().parent.parent.parent
        return cls(path) if os.path.isfile(path / SCENARIO) else None

    def checkpoint(self, name: str) -> Path:
        """Folder to read the checkpoint `name` from, ``best`` or ``last``, whether it exists or not."""
        return standing(self.path / "checkpoints" / name)

    def new_checkpoint(self, name: str) -> AbstractContextManager[Path]:
        """Give an empty folder that becomes the checkpoint `name` when the block is done."""
        return new_folder(self.path / "checkpoints" / name)

    def table(self, name: str, columns: Iterable[str]) -> Table:
        return Table(self.path / name, columns)

    def cut_table(self, name: str, env_steps: int) -> None:
        """Drop the rows of a table that were written after `env_steps`, when a run is taken up from there."""
        if (self.path / name).exists():
            self.write_text(name, cut_table(self.path / name, env_steps))

    def inside(self, path: str) -> str:
        """The path of a file from the run folder on; unchanged where the file lies elsewhere."""
        home = self.path.resolve()
        return Path(path).relative_to(home).as_posix() if Path(path).is_relative_to(home) else path

    def write_text(self, name: str, text: str) -> Path:
        """Write a file of the run whole."""
        return write_atomically(self.path / name, text.encode())

    def write_json(self, name: str, value: Any) -> Path:
        return self.write_text(name, json.dumps(value, indent=2) + "\n")

    def read_json(self, name: str) -> dict[str, Any]:
        """Read a JSON object of the run.

        Raises:
            DockctlError: it is missing or broken.
        """
        path = self.path / name
        with reading(path):
            value = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(value, dict):
            raise DockctlError(f"{path}: cannot be read: expected a JSON object")
        return value

    def copy_files(self, folder: str, files: Iterable[Path]) -> dict[str, str]:
        """Copy files into a folder of the run and return the SHA-256 of each by its path in the run."""
        hashes = {}
        for number, file in enumerate(files):
            content = file.read_bytes()
            name = f"{folder}/{number:02d}-{file.name}"
            (self.path / folder).mkdir(exist_ok=True)
            write_atomically(self.path / name, content)
            hashes[name] = hashlib.sha256(content).hexdigest()
        return hashes
