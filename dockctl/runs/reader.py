"""Read the task, the scene and the tables of a run folder, for figures."""

from __future__ import annotations

import io
import logging
import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.reading import MAX_VALUES, read_bytes, read_json, reading
from dockctl.run_files import (
    ARCHIVED_AS,
    EPISODES_CSV,
    EVALUATIONS_CSV,
    RECORDING,
    SCENARIO,
    SCENE,
    TRAJECTORIES_CSV,
    UPDATES_CSV,
)
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.base import Model, Pose
from dockctl.scenarios.problems import validate
from dockctl.scenarios.schema import Task
from dockctl.scenarios.training import Evaluation
from dockctl.scenarios.yaml_tree import read_file

log = logging.getLogger(__name__)
EPISODES = ("episode", "start_kind", "return", "steps", "outcome", "phase", "epsilon")
EVALUATIONS = ("env_steps", "pose", "outcome", "best")
TRAJECTORIES = (
    *("pose", "outcome", "time_s", "x_m", "y_m", "heading_deg", "u_mps", "v_mps", "r_degps"),
    *("propeller_n", "rudder_deg", "distance_m", "heading_error_deg", "phase"),
)
UPDATES = ("env_steps",)
"""Columns that the figures require; the metrics in ``updates.csv`` depend on the algorithm."""
SOURCES = (SCENARIO, SCENE, EPISODES_CSV, UPDATES_CSV, EVALUATIONS_CSV, TRAJECTORIES_CSV)
"""Files that `read_run` reads."""
TEXT = ("start_kind", "outcome", "collided_with", "berth", "behavior", "factor")
"""Columns that contain text; all others contain numbers."""
COMPLETE = ("env_steps", "pose", "time_s", "x_m", "y_m", "heading_deg")
"""Columns that must not have empty cells, where they are required."""
WHOLE = ("pose",)
"""Columns of integers."""
MAX_COLUMNS = 5_000


@dataclass(frozen=True)
class Run:
    """A run, finished or not, or a recording; a table that is missing or has no rows yet is None.

    Attributes:
        recorded: name of the policy of a recording; empty for a run.
    """

    folder: Path
    scenario: str
    seed: int
    recorded: str
    task: Task
    tests: tuple[Pose, ...]
    scene: Scene
    episodes: pd.DataFrame | None
    updates: pd.DataFrame | None
    evaluations: pd.DataFrame | None
    trajectories: pd.DataFrame | None

    @property
    def missing(self) -> list[str]:
        """File names of the tables of a run that are missing or have no rows yet."""
        if self.recorded:
            return []
        tables = {
            EPISODES_CSV: self.episodes,
            UPDATES_CSV: self.updates,
            EVALUATIONS_CSV: self.evaluations,
            TRAJECTORIES_CSV: self.trajectories,
        }
        return [name for name, table in tables.items() if table is None]

    @property
    def caption(self) -> str:
        """Scenario, and seed or recorded policy, for subtitles."""
        which = f"policy {self.recorded}" if self.recorded else f"seed {self.seed}"
        return f"scenario {self.scenario}, {which}"

    @property
    def policy(self) -> str:
        """Whose trajectories are stored, for titles."""
        return "the recorded policy" if self.recorded else "the best policy"


class _Drawn(Model):
    """The sections of a resolved scenario that its figures need."""

    name: str
    task: Task
    training: dict[str, Any]
    evaluation: Evaluation = Evaluation()


def read_run(folder: Path) -> Run:
    """Read a run folder or a recording.

    Raises:
        DockctlError: it is not a run folder, a file is damaged, or there is no table to draw from.
    """
    path = RunDirectory.open(folder).path / SCENARIO
    try:
        tree = read_file(path, str(path))
        assert isinstance(tree.value, dict)
        given = validate(tree.without(*tree.value.keys() - _Drawn.model_fields.keys()), _Drawn)
        seed = int(given.training["seed"])
    except (KeyError, TypeError, ValueError) as error:
        message = f"{path}: not the resolved scenario of a run: training.seed: {error}"
        raise DockctlError(message, code="not_readable") from None
    evaluations = read_table(folder / EVALUATIONS_CSV, EVALUATIONS)
    if evaluations is not None and "start_kind" not in evaluations:  # written by an early version
        evaluations = evaluations.assign(start_kind="pose")
    run = Run(
        folder=folder,
        scenario=given.name,
        seed=seed,
        recorded=_recorded_policy(folder),
        task=given.task,
        tests=given.evaluation.poses or given.task.initial,
        scene=read_scene(folder / SCENE),
        episodes=read_table(folder / EPISODES_CSV, EPISODES),
        updates=read_table(folder / UPDATES_CSV, UPDATES),
        evaluations=evaluations,
        trajectories=read_table(folder / TRAJECTORIES_CSV, TRAJECTORIES),
    )
    if run.episodes is None and run.trajectories is None:
        raise DockctlError(
            f"{folder}: nothing to plot yet: {EPISODES_CSV} and {TRAJECTORIES_CSV} are missing or empty",
            code="not_found",
        )
    return run


def _recorded_policy(folder: Path) -> str:
    path = folder / RECORDING
    if not path.is_file():
        return ""
    facts = read_json(path)
    with reading(path):
        policy = facts["policy"]
        return str(policy.get("name") or f"trained on {policy['scenario']}, seed {policy['seed']}")


def read_scene(path: Path) -> Scene:
    """Read the plan view of the harbor, or the shared one that an archived run points to.

    Raises:
        DockctlError: it is missing or damaged.
    """
    data = read_json(path)
    with reading(path):
        if ARCHIVED_AS in data:
            data = read_json(path.parent / data[ARCHIVED_AS])
        return Scene.from_json(data)


def read_table(path: Path, columns: Collection[str]) -> pd.DataFrame | None:
    """Read the complete rows of a CSV table, plain or gzipped; None if it is missing or has none.

    Raises:
        DockctlError: it is not a table, lacks one of `columns`, or has text in a numeric column.
    """
    if not path.exists():
        path = path.with_name(f"{path.name}.gz")
    if not path.exists():
        return None
    content = read_bytes(path)
    complete = content[: content.rfind(b"\n") + 1]
    if complete and complete != content:  # after a crash, or while the table is being written
        log.warning("%s: the last row is incomplete and is ignored", path)
        content = complete
    with reading(path):
        _require_rows(content)
        try:
            table = pd.read_csv(io.BytesIO(content), keep_default_na=False, na_values=["", "nan"])
        except pd.errors.EmptyDataError:
            return None
        if not isinstance(table.index, pd.RangeIndex):
            raise ValueError("rows have more cells than the header")
    if missing := [column for column in columns if column not in table]:
        raise DockctlError(
            f"{path}: not a table of a run: missing columns {', '.join(missing)}", code="missing_key"
        )
    for column in (name for name in table if name not in TEXT):
        numbers = pd.to_numeric(table[column], errors="coerce")
        wrong = numbers.isna() & table[column].notna()
        if column in columns:
            wrong |= numbers.abs() == math.inf
            if column in COMPLETE:
                wrong |= numbers.isna()
            if column in WHOLE:
                wrong |= (numbers % 1 != 0) | (numbers.abs() > MAX_VALUES)
        if wrong.any():
            line, found = int(str(wrong.idxmax())) + 2, table[column][wrong].iloc[0]
            kind = "whole" if column in WHOLE else "finite"
            message = f"{path}:{line}: {column}: expected a {kind} number, found '{found}'"
            raise DockctlError(message, code="wrong_type")
        if column in WHOLE and column in columns:
            table[column] = numbers.astype("int64")
    return table if len(table) else None


def _require_rows(content: bytes) -> None:
    """Check the size of a table before it is parsed.

    Raises:
        ValueError: it has too many values or columns, or a cell that spans lines.
    """
    if content.count(b",") + content.count(b"\n") > MAX_VALUES:
        raise ValueError(f"contains more than {MAX_VALUES:,} values")
    for number, line in enumerate(io.BytesIO(content), 1):
        if line.count(b",") >= MAX_COLUMNS or line.count(b'"') % 2:
            raise ValueError(f"line {number} is not a row of at most {MAX_COLUMNS:,} cells")
