"""Archive the small files of finished runs: enough for every figure and number, without checkpoints.

An archived run is read like a run folder. Its large tables are compressed, and its plan view refers to one
file that all runs in the same harbor share.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
from collections.abc import Callable
from pathlib import Path

from dockctl.reading import read_bytes, read_json, reading
from dockctl.run_files import (
    ARCHIVED_AS,
    EPISODES_CSV,
    EVALUATION,
    EVALUATIONS_CSV,
    LATENCY,
    MAP,
    PROVENANCE,
    RETURNS,
    SCENARIO,
    SCENE,
    SCENES,
    TIMING_CSV,
    TRAJECTORIES_CSV,
    TRANSFER,
    UPDATES_CSV,
    archived_name,
)
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import make_folder, new_folder, write_atomically, write_json
from dockctl.runs.tables import to_csv

COPIED = (
    EVALUATIONS_CSV,
    TIMING_CSV,
    f"{EVALUATION}*.csv",
    f"{MAP}.csv",
    f"{RETURNS}.csv",
    f"{LATENCY}.json",
)
COMPRESSED = (EPISODES_CSV, f"{LATENCY}.csv")
FACTS = ("dockctl", "git_commit", "seed", "python", "libraries", "started", "finished", "stop_reason")
"""Archived keys of the provenance; others contain paths of the machine."""
HARDWARE = ("processor", "cores")
UPDATE_ROWS = 400
TRAJECTORIES = 16
"""Maximum number of archived trajectories per run."""


def archive(run: Path, results: Path, experiment: str, seed: int) -> Path:
    """Copy the small files of a finished run to ``<results>/<experiment>/seed<N>/``; replace an earlier copy.

    Raises:
        DockctlError: a file of the run is damaged, or the folder cannot be written.
    """
    archived = results / experiment / archived_name(seed)
    with new_folder(archived) as folder:
        for file in dict.fromkeys(path for pattern in COPIED for path in sorted(run.glob(pattern))):
            (folder / file.name).write_bytes(read_bytes(file))
        for name in COMPRESSED:
            _compress(run / name, folder / f"{Path(name).name}.gz")
        _compress(run / UPDATES_CSV, folder / f"{UPDATES_CSV}.gz", _thinned)
        write_json(folder / PROVENANCE, _facts(run))
        _archive_recording(run, folder, results)
        for recording in sorted((run / TRANSFER).glob("*")):
            (folder / TRANSFER / recording.name).mkdir(parents=True)
            _archive_recording(recording, folder / TRANSFER / recording.name, results)
    return archived


def _archive_recording(source: Path, folder: Path, results: Path) -> None:
    """Copy scenario, plan view and trajectories, which are needed to draw a maneuver."""
    (folder / SCENARIO).write_bytes(read_bytes(source / SCENARIO))
    _compress(source / TRAJECTORIES_CSV, folder / f"{TRAJECTORIES_CSV}.gz", _first_trajectories)
    content = read_bytes(source / SCENE)
    with reading(source / SCENE):
        name = f"{read_json(source / SCENE)['name']}-{hashlib.sha256(content).hexdigest()[:8]}.json.gz"
    target = results / SCENES / name
    if not target.exists():
        make_folder(target.parent)
        write_atomically(target, gzip.compress(content, mtime=0))
    up = "/".join([".."] * len(folder.relative_to(results).parts))
    write_json(folder / SCENE, {ARCHIVED_AS: f"{up}/{SCENES}/{name}"})


def _facts(run: Path) -> dict[str, object]:
    facts = RunDirectory(run).read_json(PROVENANCE)
    with reading(run / PROVENANCE):
        hardware = facts.get("hardware", {})
        return {name: facts.get(name) for name in FACTS} | {name: hardware.get(name) for name in HARDWARE}


def _compress(source: Path, target: Path, change: Callable[[str], str] = str) -> None:
    if source.is_file():
        content = read_bytes(source)
        with reading(source):
            text = change(content.decode("utf-8"))
        target.write_bytes(gzip.compress(text.encode(), mtime=0))


def _thinned(text: str) -> str:
    """Return at most `UPDATE_ROWS` evenly spaced rows of a table, including the last one."""
    header, *lines = text.splitlines(keepends=True)
    stride = -(-len(lines) // UPDATE_ROWS) or 1
    return "".join([header, *lines[::-1][::stride][::-1]])


def _first_trajectories(text: str) -> str:
    rows = csv.DictReader(io.StringIO(text))
    return to_csv([row for row in rows if int(row["pose"]) < TRAJECTORIES], rows.fieldnames or ())
