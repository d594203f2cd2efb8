"""The tables of a run folder: columns, with units in their names, and CSV reading and writing."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from dockctl.runs.files import reading, writing

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

EVALUATIONS = ("env_steps", "pose", *EPISODE_RESULT, "best")
"""Greedy episodes during training, one row per pose; `best` is 1 if the policy was the best so far."""

EVALUATION = ("start_kind", "start", "berth", "x_m", "y_m", "heading_deg", *EPISODE_RESULT, "time_s")
"""Episodes of ``dockctl evaluate``."""

START_KINDS = {
    "pose": "evaluation poses",
    "random": "random starts",
    "trained": "trained berths",
    "held_out": "held-out berths",
}
"""Values of `start_kind` in an evaluation, and their plain names."""
START_KEYS = {
    "pose": "test_poses",
    "random": "random_starts",
    "trained": "trained_berths",
    "held_out": "held_out_berths",
}
"""Keys of their summaries in ``evaluation.json``."""

MAP_START = ("dx_m", "dy_m", "dheading_deg", "x_m", "y_m", "heading_deg", "blocked")
MAP = (*MAP_START, *EPISODE_RESULT, "time_s")
"""Starts of ``dockctl map``, by their offset from the center pose; a blocked start has no result."""

RETURNS = ("behavior", "outcome", "steps", "time_s", "distance_unit_m", "return", "intermediate_discount")
"""Discounted returns of behaviors, of ``dockctl returns``; followed by one ``reward_<term>`` per term."""

TIMING = ("env_steps", "wall_s")
"""Seconds since the start of training, in a separate table so that the others repeat byte for byte."""

TRAJECTORIES = (
    "pose", "step", "outcome", "time_s", "x_m", "y_m", "heading_deg", "u_mps", "v_mps", "r_degps",
    "propeller_n", "rudder_deg", "distance_m", "heading_error_deg", "phase", "reward",
)  # fmt: skip
"""Greedy episodes step by step; `outcome` is that of the episode; one ``range_<i>_m`` per sector follows."""


class Table:
    """A CSV file that grows by complete rows; the header is written with the first one.

    Args:
        path: the file; rows are appended if it exists.
        columns: the first columns; other keys of the first row are appended.
    """

    def __init__(self, path: Path, columns: Iterable[str]) -> None:
        self._path = path
        self._columns = list(columns)
        self._has_header = False

    def append(self, rows: Iterable[Mapping[str, Value]]) -> None:
        """Append rows in one write, so that a reader never sees an incomplete row.

        Raises:
            DockctlError: the file cannot be written.
        """
        rows = list(rows)
        if not rows:
            return
        if not self._has_header and (header := _header(self._path)):
            self._columns, self._has_header = header, True
        if not self._has_header:
            self._columns = all_columns(self._columns, rows)
        text = to_csv(rows, self._columns, header=not self._has_header)
        with writing(self._path), self._path.open("a", encoding="utf-8", newline="") as file:
            file.write(text)
        self._has_header = True


def _header(path: Path) -> list[str]:
    if not path.exists():
        return []
    with path.open(encoding="utf-8") as file:
        return next(csv.reader(file), [])


def all_columns(first: Iterable[str], rows: Sequence[Mapping[str, Value]]) -> list[str]:
    """Return the columns `first`, followed by the other keys of the first row."""
    return list(dict.fromkeys([*first, *rows[0]]))


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


def cut_table(path: Path, env_steps: int) -> str:
    """Return the text of a table without the rows after `env_steps`.

    Raises:
        DockctlError: the file cannot be read.
    """
    rows = csv.DictReader(io.StringIO(_complete_lines(path)))
    if rows.fieldnames is None:
        return ""
    return to_csv([row for row in rows if int(row["env_steps"]) <= env_steps], rows.fieldnames)


def _complete_lines(path: Path) -> str:
    """Return the text of a table without a last line that a crash cut short."""
    with reading(path):
        text = path.read_text(encoding="utf-8")
    return text[: text.rfind("\n") + 1]
