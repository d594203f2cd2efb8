"""The tables of a run folder: columns, with units in their names, and CSV reading and writing."""

from __future__ import annotations

import csv
import hashlib
import io
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from dockctl.reading import read_bytes
from dockctl.runs.files import sync, write_atomically, writing

MAX_TABLE_BYTES = 2_000_000_000
"""Maximum size of a table that a run continues: about 10 million episodes."""

Value = str | int | float | bool | None

EPISODES = (
    "episode", "env_steps", "boat", "start_kind", "start_index", "return", "steps", "outcome",
    "collided_with", "phase", "epsilon", "distance_m", "heading_error_deg", "speed_mps",
)  # fmt: skip
"""Training episodes; followed by one column ``reward_<term>`` per reward term."""

RECENT = 100
"""Number of most recent training episodes in progress summaries."""

UPDATES = ("update", "env_steps", "loss", "td_error", "q_mean", "gradient_norm", "learning_rate")
"""Gradient steps, averaged over the updates since the previous row."""

EPISODE_RESULT = (
    "outcome", "collided_with", "phase", "return", "steps", "distance_m", "heading_error_deg", "speed_mps",
    "path_length_m", "clearance_m", "control_changes",
)  # fmt: skip
"""Result of one greedy episode."""

MANEUVER = ("contact_speed_mps", "propeller_change_n", "rudder_change_deg")
"""Maneuver: speed at a collision, and mean command changes per step."""

EVALUATIONS = ("env_steps", "start_kind", "pose", *EPISODE_RESULT, "best")
"""Greedy episodes during training, from the evaluation poses and, less often, from the validation starts.

`pose` is the number of the pose or start, and `best` is 1 if the policy was the best so far.
"""

EVALUATION = (
    "start_kind", "start", "berth", "x_m", "y_m", "heading_deg", *EPISODE_RESULT, *MANEUVER, "time_s",
)  # fmt: skip
"""Episodes of ``dockctl evaluate``."""

START_KINDS = {
    "pose": "evaluation poses",
    "random": "random starts",
    "trained": "trained berths",
    "held_out": "held-out berths",
}
"""Values of `start_kind` in an evaluation, and their names in text."""
START_KEYS = {
    "pose": "test_poses",
    "random": "random_starts",
    "trained": "trained_berths",
    "held_out": "held_out_berths",
}
"""Keys of their summaries in ``evaluation.json``."""

EXPLORING, RETRIED = "exploring", "retried"
"""Values of `start_kind` in a training of starts that are not drawn around an initial pose."""

OUTCOMES = ("docked", "collision", "timeout")
"""Values of `outcome` (`dockctl.sim.goal.StepStatus.outcome`)."""

MAP_START = ("dx_m", "dy_m", "dheading_deg", "x_m", "y_m", "heading_deg", "blocked")
MAP = (*MAP_START, *EPISODE_RESULT, *MANEUVER, "time_s")
"""Starts of ``dockctl map``, by their offset from the center pose; a blocked start has no result."""

ENVELOPE = ("factor", "value", "episodes", *OUTCOMES)
"""Outcomes by value of one factor, of ``dockctl envelope``."""

RETURNS = ("behavior", "outcome", "steps", "time_s", "distance_unit_m", "return", "intermediate_discount")
"""Discounted returns of behaviors, of ``dockctl returns``; followed by one ``reward_<term>`` per term."""

TIMING = ("env_steps", "wall_s")
"""Seconds since the start of training, in a separate table so that the others repeat byte for byte."""

TRAJECTORIES = (
    "pose", "step", "outcome", "time_s", "x_m", "y_m", "heading_deg", "u_mps", "v_mps", "r_degps",
    "propeller_n", "rudder_deg", "distance_m", "heading_error_deg", "phase", "reward",
)  # fmt: skip
"""Greedy episodes step by step; `outcome` is that of the episode; one ``range_<i>_m`` per sector follows."""

CONDITION_COLUMNS = {
    "current": ("current_x_mps", "current_y_mps"),
    "wind": ("wind_x_mps", "wind_y_mps"),
    "actuation": ("actual_propeller_n", "actual_rudder_deg"),
    "measured_pose": ("measured_x_m", "measured_y_m", "measured_heading_deg"),
    "measured_velocity": ("measured_u_mps", "measured_v_mps", "measured_r_degps"),
}
"""Columns of trajectories that follow in scenarios with such conditions, by the key of ``info``."""


class TableObserver(Protocol):
    """Follows the tables of a training run."""

    def appended(self, table: str, rows: Sequence[Mapping[str, Value]]) -> None:
        """Receive rows that were appended to the table with this file name."""

    def restored(self, table: str, env_steps: int, rows: Sequence[Mapping[str, str]]) -> None:
        """Drop what the table had after a save, from which training continues.

        Args:
            table: file name.
            env_steps: steps at the save; rows of this step may have been appended before and after it.
            rows: the rows of this step that remain, as text.
        """


class Table:
    """A CSV file that grows by complete rows; the header is written with the first one.

    Args:
        path: the file; rows are appended if it exists.
        columns: the first columns; other keys of the first row are appended.
        observer: receives every row.
    """

    def __init__(self, path: Path, columns: Iterable[str], observer: TableObserver | None = None) -> None:
        self._path, self._observer = path, observer
        self._columns = list(columns)
        self._take(self._read())

    def append(self, rows: Iterable[Mapping[str, Value]]) -> None:
        """Append rows in one write, so that a reader never sees an incomplete row.

        Raises:
            DockctlError: the file cannot be written.
        """
        rows = list(rows)
        if not rows:
            return
        if not self._size:
            self._columns = all_columns(self._columns, rows)
        content = to_csv(rows, self._columns, header=not self._size).encode()
        with writing(self._path), self._path.open("ab") as file:
            file.write(content)
        self._count(content)
        if self._observer:
            self._observer.appended(self._path.name, rows)

    def save(self) -> dict[str, Any]:
        """Wait until all rows are on disk, and return what `restore` needs to return to this state.

        Raises:
            DockctlError: the file cannot be written.
        """
        if self._size:
            with writing(self._path):
                sync(self._path)
                sync(self._path.parent)
        return {"lines": self._lines, "bytes": self._size, "sha256": self._hash.hexdigest()}

    def restore(self, saved: Mapping[str, Any] | None, env_steps: int) -> str | None:
        """Remove the rows that were appended after `save`; in a damaged file, keep the intact rows.

        Args:
            saved: the result of `save`; None in checkpoints from early versions.
            env_steps: steps at that time.

        Returns:
            A message about lost rows, or None.

        Raises:
            DockctlError: the file cannot be read or written.
        """
        content, lost = self._read(), None
        kept = content[: saved["bytes"]] if saved else _intact_lines(content, env_steps)
        if saved and hashlib.sha256(kept).hexdigest() != saved["sha256"]:
            kept = _intact_lines(content, env_steps, saved["lines"])
            rows, left = saved["lines"] - 1, max(kept.count(b"\n") - 1, 0)
            lost = (
                f"{self._path}: damaged: {rows - left:,} of {rows:,} rows up to step {env_steps:,} are lost"
            )
        if kept != content:
            write_atomically(self._path, kept)
        self._take(kept)
        if self._observer:
            rows = csv.DictReader(io.StringIO(kept.decode(errors="replace")))
            remaining = [row for row in rows if row.get("env_steps") == str(env_steps)]
            self._observer.restored(self._path.name, env_steps, remaining)
        return lost

    def _read(self) -> bytes:
        return read_bytes(self._path, MAX_TABLE_BYTES) if os.path.exists(self._path) else b""

    def _take(self, content: bytes) -> None:
        """Continue after this content."""
        self._hash, self._size, self._lines = hashlib.sha256(), 0, 0
        self._count(content)
        if content:
            self._columns = next(csv.reader([content.partition(b"\n")[0].decode("utf-8", "replace")]))

    def _count(self, content: bytes) -> None:
        self._hash.update(content)
        self._size += len(content)
        self._lines += content.count(b"\n")


def _intact_lines(content: bytes, env_steps: int, most: int | None = None) -> bytes:
    """Return the header and the complete rows up to `env_steps`; a crash may leave partial rows and NULs."""
    header, *lines = content.split(b"\n")[:-1][:most] or [b""]
    names = _cells(header)
    if "env_steps" not in names:
        return b""
    column = names.index("env_steps")

    def intact(cells: list[str]) -> bool:
        is_row = len(cells) == len(names) and re.fullmatch("[0-9]{1,18}", cells[column])
        return bool(is_row) and int(cells[column]) <= env_steps

    return b"".join(line + b"\n" for line in (header, *(line for line in lines if intact(_cells(line)))))


def _cells(line: bytes) -> list[str]:
    """Return the cells of a line of a table; none for a damaged line."""
    try:
        return [] if b"\0" in line else next(csv.reader([line.decode()]), [])
    except (UnicodeDecodeError, csv.Error):
        return []


def all_columns(first: Iterable[str], rows: Sequence[Mapping[str, Value]]) -> list[str]:
    """Return the columns `first`, followed by the other keys of the rows in the order of their appearance."""
    return list(dict.fromkeys([*first, *(key for row in rows for key in row)]))


def to_csv(rows: Iterable[Mapping[str, Value]], columns: Iterable[str], *, header: bool = True) -> str:
    """Return rows as CSV text: numbers with six significant digits, missing values as empty cells."""
    columns = list(columns)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if header:
        writer.writerow(columns)
    writer.writerows([_cell(row.get(column)) for column in columns] for row in rows)
    return text.getvalue()


def _cell(value: Value) -> str | int:
    if value is None:
        return ""
    if isinstance(value, str | int):
        return int(value) if isinstance(value, bool) else value
    return format(float(value), ".6g")
