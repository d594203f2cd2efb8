"""Logs of a training run for TensorBoard and Weights & Biases, with the same numbers as its tables.

Every row of ``episodes.csv`` and ``updates.csv`` is a point at its number of environment steps, for example
``episodes/return``. The greedy episodes of one evaluation are one point, their mean, for example
``evaluations/pose/docked``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, Protocol

from dockctl.errors import DockctlError, nearest
from dockctl.run_files import EPISODES_CSV, EVALUATIONS_CSV, SCENARIO, TIMING_CSV, UPDATES_CSV
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import writing
from dockctl.runs.listing import summarize
from dockctl.runs.tables import Value
from dockctl.scenarios.yaml_tree import read_file

LABELS = ("episode", "update", "env_steps", "boat", "start_index", "pose")
"""Columns that identify a row."""


Point = tuple[int, dict[str, float]]
"""Environment steps, and values by name."""


class Log(Protocol):
    """A log of values by name and environment steps."""

    def write(self, env_steps: int, values: Mapping[str, float]) -> None:
        """Add one point for each name."""

    def rewind(self, env_steps: int, points: Sequence[Point]) -> None:
        """Drop the points from `env_steps` on, except these, if the log supports it."""

    def flush(self) -> None:
        """Write buffered points, before a checkpoint is saved."""

    def close(self) -> None:
        """End the log."""


class TensorBoard:
    """Event files in ``<run>/tensorboard``; a resumed run adds one that replaces the later points."""

    def __init__(self, run: RunDirectory) -> None:
        writer = import_module("tensorboard.summary.writer.event_file_writer")
        self._event = import_module("tensorboard.compat.proto.event_pb2")
        self._summary = import_module("tensorboard.compat.proto.summary_pb2")
        folder = run.path / "tensorboard"
        with writing(folder):
            self._writer = writer.EventFileWriter(str(folder))

    def write(self, env_steps: int, values: Mapping[str, float]) -> None:
        points = [self._summary.Summary.Value(tag=name, simple_value=value) for name, value in values.items()]
        self._add(env_steps, summary=self._summary.Summary(value=points))

    def rewind(self, env_steps: int, points: Sequence[Point]) -> None:
        start = self._event.SessionLog(status=self._event.SessionLog.START)
        self._add(env_steps, session_log=start)  # readers drop the points from this step on
        for point in points:
            self.write(*point)

    def flush(self) -> None:
        self._writer.flush()

    def close(self) -> None:
        self._writer.close()

    def _add(self, env_steps: int, **content: Any) -> None:
        self._writer.add_event(self._event.Event(step=env_steps, wall_time=time.time(), **content))


class WeightsAndBiases:
    """An offline Weights & Biases run in ``<run>/wandb``; ``wandb sync`` uploads it.

    All parts of a resumed run have the same identifier. Points cannot be dropped, so steps that are repeated
    after a crash are in the log twice.
    """

    def __init__(self, run: RunDirectory) -> None:
        wandb = import_module("wandb")
        scenario, summary = run.path / SCENARIO, summarize(run)
        self._run = wandb.init(
            project="dockctl",
            dir=str(run.path),
            id=f"{run.path.parent.name}-{run.path.name}",
            group=run.path.parent.name,
            name=summary.name or run.path.name,
            tags=summary.tags,
            config=read_file(scenario, str(scenario)).to_python(),
            mode="offline",
            settings=wandb.Settings(silent=True, console="off", disable_git=True),
        )
        self._run.define_metric("*", step_metric="env_steps")

    def write(self, env_steps: int, values: Mapping[str, float]) -> None:
        self._run.log({"env_steps": env_steps, **values})

    def rewind(self, env_steps: int, points: Sequence[Point]) -> None:
        """Do nothing: the format has no such record."""

    def flush(self) -> None:
        """Do nothing: the service process of wandb writes on its own."""

    def close(self) -> None:
        self._run.finish()


LOGS: dict[str, Callable[[RunDirectory], Log]] = {"tensorboard": TensorBoard, "wandb": WeightsAndBiases}
"""Logs by name, which is also the name of the package and of the extra."""


class Mirror:
    """Writes the rows of the tables to logs.

    Args:
        logs: open logs.
    """

    def __init__(self, logs: Sequence[Log]) -> None:
        self._logs = logs
        self._remaining: list[Point] = []

    def appended(self, table: str, rows: Sequence[Mapping[str, Value]]) -> None:
        """Log rows that were appended to the table with this file name."""
        for log in self._logs:
            for env_steps, values in points(table, rows):
                log.write(env_steps, values)
            if table == TIMING_CSV:
                log.flush()

    def restored(self, table: str, env_steps: int, rows: Sequence[Mapping[str, str]]) -> None:
        """Rewind the logs once all tables have been restored; see `TableObserver`."""
        self._remaining += points(table, [{name: _value(text) for name, text in row.items()} for row in rows])
        if table == TIMING_CSV:  # the last table
            for log in self._logs:
                log.rewind(env_steps, self._remaining)
            self._remaining.clear()


def _value(text: str) -> Value:
    """Return the number in a cell, or its text if it is not a number; None for an empty cell."""
    try:
        return float(text) if text else None
    except ValueError:
        return text


def points(table: str, rows: Sequence[Mapping[str, Value]]) -> Iterator[Point]:
    """Yield the environment steps and the values by name of rows that were appended together."""
    stem = Path(table).stem
    if table in (EPISODES_CSV, UPDATES_CSV):
        for row in rows:
            yield _env_steps(row), {f"{stem}/{name}": value for name, value in _numbers(row).items()}
    elif table == EVALUATIONS_CSV and rows:
        for kind in dict.fromkeys(str(row["start_kind"]) for row in rows):
            group = [_numbers(row) for row in rows if row["start_kind"] == kind]
            names = dict.fromkeys(name for numbers in group for name in numbers)
            given = {name: [numbers[name] for numbers in group if name in numbers] for name in names}
            means = {f"{stem}/{kind}/{name}": sum(values) / len(values) for name, values in given.items()}
            yield _env_steps(rows[0]), means


def _env_steps(row: Mapping[str, Value]) -> int:
    return int(row["env_steps"] or 0)


def _numbers(row: Mapping[str, Value]) -> dict[str, float]:
    """Return the measurements of a row, and whether its episode docked."""
    numbers = {
        name: float(value)
        for name, value in row.items()
        if name not in LABELS and value is not None and not isinstance(value, str)
    }
    return {**numbers, "docked": float(row["outcome"] == "docked")} if "outcome" in row else numbers


def require_logs(names: Sequence[str]) -> None:
    """Check that these logs can be written.

    Raises:
        DockctlError: one is unknown, or its package is not installed.
    """
    for name in names:
        if name not in LOGS:
            message = f"--log {name}: expected one of {', '.join(LOGS)}"
            raise DockctlError(message, code="unknown_name", suggestion=nearest(name, LOGS))
        try:
            metadata.version(name)
        except metadata.PackageNotFoundError:
            message = f"--log {name}: the package {name} is not installed: pip install 'dockctl[{name}]'"
            raise DockctlError(message, code="unavailable") from None


@contextmanager
def logged(run: RunDirectory, names: Sequence[str]) -> Iterator[None]:
    """Also write the tables that the block opens in `run` to these logs."""
    logs: list[Log] = []
    try:
        for name in dict.fromkeys(names):
            logs.append(LOGS[name](run))
        run.observer = Mirror(logs) if logs else None
        yield
    finally:
        run.observer = None
        for log in logs:
            log.close()
