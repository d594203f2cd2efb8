"""The small files of a run, copied to where results are kept: enough for every figure and every number.

A kept run is a run folder without checkpoints; its large tables are compressed, and its plan view points
to one file for all runs in the same harbor.
"""

from __future__ import annotations

import csv
import gzip
import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path

from dockctl.runs.directory import PROVENANCE, SCENARIO, RunDirectory
from dockctl.runs.files import new_folder, reading, writing
from dockctl.runs.tables import to_csv

PLAIN = ("evaluations.csv", "timing.csv", "evaluation*.csv", "map.csv", "returns.csv", "figures/latency.json")
COMPRESSED = ("episodes.csv", "figures/latency.csv")
FACTS = ("dockctl", "git_commit", "seed", "python", "libraries", "started", "finished", "stop_reason")
"""What is kept of a run's provenance; paths of the machine are not."""
MACHINE = ("processor", "cores")
UPDATE_ROWS = 400
TRACKS = 16
"""Trajectories that are kept of each run."""
SCENES = "scenes"
POINTER = "kept_as"
ELSEWHERE, FAILURES = "elsewhere", "failures"
"""Where a run has recordings of its policy in other places, and the one of its nearest failures."""


def keep(run: Path, results: Path, experiment: str, seed: int) -> Path:
    """Copy what is small of the finished run to ``<results>/<experiment>/seed<N>/``, replacing what is there.

    Raises:
        DockctlError: a file of the run is broken, or the place cannot be written to.
    """
    kept = results / experiment / f"seed{seed}"
    with new_folder(kept) as folder:
        for file in dict.fromkeys(path for pattern in PLAIN for path in sorted(run.glob(pattern))):
            (folder / file.name).write_bytes(file.read_bytes())
        for name in COMPRESSED:
            _compress(run / name, folder / f"{Path(name).name}.gz")
        _compress(run / "updates.csv", folder / "updates.csv.gz", _thinned)
        _write_json(folder / PROVENANCE, _facts(run))
        _keep_course(run, folder, results)
        for course in sorted((run / ELSEWHERE).glob("*")):
            (folder / ELSEWHERE / course.name).mkdir(parents=True)
            _keep_course(course, folder / ELSEWHERE / course.name, results)
    return kept


def _keep_course(source: Path, folder: Path, results: Path) -> None:
    """Scenario, plan view and trajectories: what a drawing of the boat's way needs."""
    with reading(source / SCENARIO):
        scenario = (source / SCENARIO).read_bytes()
    (folder / SCENARIO).write_bytes(scenario)
    _compress(source / "trajectories.csv", folder / "trajectories.csv.gz", _first_tracks)
    with reading(source / "scene.json"):
        content = (source / "scene.json").read_bytes()
        name = f"{json.loads(content)['name']}-{hashlib.sha256(content).hexdigest()[:8]}.json.gz"
    target = results / SCENES / name
    if not target.exists():
        target.parent.mkdir(parents=True, exist_ok=True)
        with writing(target):
            target.write_bytes(gzip.compress(content, mtime=0))
    up = "/".join([".."] * len(folder.relative_to(results).parts))
    _write_json(folder / "scene.json", {POINTER: f"{up}/{SCENES}/{name}"})


def _facts(run: Path) -> dict[str, object]:
    facts = RunDirectory(run).read_json(PROVENANCE)
    machine = facts.get("hardware", {})
    return {name: facts.get(name) for name in FACTS} | {name: machine.get(name) for name in MACHINE}


def _compress(source: Path, target: Path, change: Callable[[str], str] = str) -> None:
    if source.is_file():
        with reading(source):
            text = change(source.read_text(encoding="utf-8"))
        target.write_bytes(gzip.compress(text.encode(), mtime=0))


def _thinned(text: str) -> str:
    """At most `UPDATE_ROWS` rows of a table, evenly apart, the last among them."""
    header, *lines = text.splitlines(keepends=True)
    stride = -(-len(lines) // UPDATE_ROWS) or 1
    return "".join([header, *lines[::-1][::stride][::-1]])


def _first_tracks(text: str) -> str:
    rows = csv.DictReader(io.StringIO(text))
    return to_csv([row for row in rows if int(row["pose"]) < TRACKS], rows.fieldnames or ())


def _write_json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")
