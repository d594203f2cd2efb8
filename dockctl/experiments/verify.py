"""Verify a run: repeat its first steps here; compare the tables and the conditions that affect them."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dockctl.errors import DockctlError
from dockctl.experiments.training import replay
from dockctl.reading import read_bytes, reading
from dockctl.run_files import EPISODES_CSV, EVALUATIONS_CSV, PROVENANCE, UPDATES_CSV
from dockctl.runs import provenance
from dockctl.runs.directory import RunDirectory
from dockctl.trust import file_digest

STEPS = 10_000
TABLES = (EPISODES_CSV, UPDATES_CSV, EVALUATIONS_CSV)
ABSENT = "-"

Rows = list[dict[str, str]]


@dataclass(frozen=True)
class TableCheck:
    """Rows of one table, as recorded and as repeated here.

    Attributes:
        rows: number of recorded rows.
        recorded, here: SHA-256 of the rows.
        difference: the first difference, or an empty string.
    """

    name: str
    rows: int
    recorded: str
    here: str
    difference: str


@dataclass(frozen=True)
class Verification:
    """Whether the first `steps` environment steps of a run repeat on this machine.

    Attributes:
        conditions: what differs between the run and this machine: name, recorded value, value here.
    """

    steps: int
    tables: tuple[TableCheck, ...]
    conditions: tuple[tuple[str, str, str], ...]

    @property
    def is_equal(self) -> bool:
        return not any(table.difference for table in self.tables)


def verify(
    path: Path, steps: int = STEPS, *, plugin_files: Sequence[Path] = (), trust: bool = False
) -> Verification:
    """Repeat the first steps of a run in a temporary folder.

    Args:
        steps: environment steps; fewer if the run has fewer, or was extended after fewer.
        plugin_files, trust: see `dockctl.evaluation.load_policy`.

    Raises:
        UntrustedError: the run has plugins that may not run; none has run.
        DockctlError: `path` is not a run, one of its files is damaged, or it has no rows for these steps.
    """
    run = RunDirectory.open(path)
    facts = run.read_json(PROVENANCE)
    recorded = {name: _rows(run.path / name) for name in TABLES}
    last = max((_env_steps(rows[-1]) for rows in recorded.values() if rows), default=0)
    steps = min(steps, *(made - 1 for made in (last, *_extensions(facts))))  # the last updates may be missing
    if not any(_env_steps(row) <= steps for rows in recorded.values() for row in rows):
        message = f"{path}: {', '.join(TABLES)} have no rows for the first {max(steps, 0):,} steps to compare"
        raise DockctlError(message, code="not_found")
    with TemporaryDirectory(prefix="dockctl-verify-") as folder:
        repeated = replay(run, steps, Path(folder), plugin_files=plugin_files, trust=trust)
        checks = [_check(name, steps, rows, _rows(repeated.path / name)) for name, rows in recorded.items()]
        now = repeated.read_json(PROVENANCE)
    now["plugins"] = {
        name: file_digest(run.path / name) if (run.path / name).is_file() else ABSENT
        for name in _mapping(facts.get("plugins"))
    }
    return Verification(steps, tuple(checks), tuple(_conditions(facts, now)))


def _extensions(facts: Mapping[str, Any]) -> Iterator[int]:
    """Yield the steps after which the run was extended: its learning rate depends on the total."""
    resumed = facts.get("resumed")
    for each in map(_mapping, resumed if isinstance(resumed, list) else ()):
        if "total_steps" in each and isinstance(made := each.get("env_steps"), int):
            yield made


def _rows(path: Path) -> Rows:
    if not path.is_file():
        return []
    content = read_bytes(path)
    with reading(path):
        rows = list(csv.DictReader(io.StringIO(content.decode("utf-8"))))
        for row in rows:
            _env_steps(row)
        return rows


def _env_steps(row: Mapping[str, str]) -> int:
    return int(row["env_steps"])


def _check(name: str, steps: int, recorded: Rows, here: Rows) -> TableCheck:
    before, now = ([row for row in rows if _env_steps(row) <= steps] for rows in (recorded, here))
    difference = ""
    if before != now:
        pairs = zip([*before, {}], [*now, {}], strict=False)
        number, (old, new) = next((n, pair) for n, pair in enumerate(pairs, 1) if pair[0] != pair[1])
        column = next(key for key in {**old, **new} if old.get(key) != new.get(key))
        difference = (
            f"row {number}, {column}: {old.get(column, ABSENT)} recorded, {new.get(column, ABSENT)} here"
        )
    return TableCheck(name, len(before), _digest(before), _digest(now), difference)


def _digest(rows: Rows) -> str:
    return hashlib.sha256(repr(rows).encode()).hexdigest()


def _conditions(recorded: Mapping[str, Any], here: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield the conditions that differ and could make the results differ."""
    for key in provenance.CONDITIONS:
        before, now = _flat(key, recorded.get(key)), _flat(key, here.get(key))
        for name in dict.fromkeys([*before, *now]):
            if before.get(name, ABSENT) != now.get(name, ABSENT):
                yield name, before.get(name, ABSENT), now.get(name, ABSENT)


def _flat(name: str, value: Any) -> dict[str, str]:
    if not isinstance(value, dict):
        return {} if value is None else {name: str(value)}
    return {path: text for key, item in value.items() for path, text in _flat(f"{name} {key}", item).items()}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}
