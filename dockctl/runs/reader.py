"""What the figures need from a run folder: its task, its scene and its tables."""

from __future__ import annotations

import gzip
import json
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import yaml
from pydantic import ValidationError

from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.runs.directory import ARCHIVED_AS
from dockctl.runs.files import reading
from dockctl.scenarios.base import Pose
from dockctl.scenarios.schema import Task
from dockctl.scenarios.training import Evaluation

EPISODES = ("episode", "start_kind", "return", "steps", "outcome", "phase", "epsilon")
EVALUATIONS = ("env_steps", "pose", "outcome", "best")
TRAJECTORIES = (
    *("pose", "outcome", "time_s", "x_m", "y_m", "heading_deg", "u_mps", "v_mps", "r_degps"),
    *("propeller_n", "rudder_deg", "distance_m", "heading_error_deg", "phase"),
)
WORDS = ("start_kind", "outcome")
"""Columns that hold text."""


@dataclass(frozen=True)
class Run:
    """A finished or interrupted run, as its folder tells it; a table that is not there yet is None."""

    folder: Path
    scenario: str
    seed: int
    task: Task
    tests: tuple[Pose, ...]
    scene: Scene
    episodes: pd.DataFrame | None
    evaluations: pd.DataFrame | None
    trajectories: pd.DataFrame | None

    @property
    def missing(self) -> list[str]:
        """Tables that are not there, or have no rows yet."""
        tables = {
            "episodes": self.episodes,
            "evaluations": self.evaluations,
            "trajectories": self.trajectories,
        }
        return [f"{name}.csv" for name, table in tables.items() if table is None]

    @property
    def caption(self) -> str:
        """Which run a figure shows, in a few words."""
        return f"scenario {self.scenario}, seed {self.seed}"


def read_run(folder: Path) -> Run:
    """Read a run folder.

    Raises:
        DockctlError: no run folder, a broken file, or no table to draw from.
    """
    if not (folder / "scenario.yaml").is_file():
        raise DockctlError(
            f"{folder}: not a run folder (it has no scenario.yaml); `dockctl train` makes one under runs/"
        )
    try:
        resolved = yaml.safe_load((folder / "scenario.yaml").read_text(encoding="utf-8"))
        task = Task.model_validate(resolved["task"])
        tests = Evaluation.model_validate(resolved.get("evaluation", {})).poses or task.initial
        scenario, seed = str(resolved["name"]), int(resolved["training"]["seed"])
    except (
        OSError,
        UnicodeDecodeError,
        yaml.YAMLError,
        KeyError,
        TypeError,
        ValueError,
        ValidationError,
    ) as error:
        raise DockctlError(
            f"{folder / 'scenario.yaml'}: not the resolved scenario of a run: {error}"
        ) from error
    run = Run(
        folder,
        scenario,
        seed,
        task,
        tests,
        read_scene(folder / "scene.json"),
        read_table(folder / "episodes.csv", EPISODES),
        read_table(folder / "evaluations.csv", EVALUATIONS),
        read_table(folder / "trajectories.csv", TRAJECTORIES),
    )
    if run.episodes is None and run.trajectories is None:
        raise DockctlError(
            f"{folder}: nothing to plot yet: episodes.csv and trajectories.csv are missing or have no rows"
        )
    return run


def read_scene(path: Path) -> Scene:
    """Read the plan view of the harbor, or the shared one that an archived run points to.

    Raises:
        DockctlError: it is missing or broken.
    """
    with reading(path):
        data = json.loads(path.read_text(encoding="utf-8"))
        if ARCHIVED_AS in data:
            data = json.loads(gzip.decompress((path.parent / data[ARCHIVED_AS]).read_bytes()))
        return Scene.from_json(data)


def read_table(path: Path, columns: tuple[str, ...]) -> pd.DataFrame | None:
    """Return a CSV table, as it is or compressed, or None where it is missing or has no rows.

    Raises:
        DockctlError: it cannot be read as a table, lacks a column, or holds text where a number belongs.
    """
    if not path.exists():
        path = path.with_name(f"{path.name}.gz")
    with reading(path):
        try:
            table = pd.read_csv(path, keep_default_na=False, na_values=["", "nan"])
        except (FileNotFoundError, pd.errors.EmptyDataError):
            return None
    missing = [column for column in columns if column not in table]
    if missing:
        raise DockctlError(f"{path}: not a table of a run, it lacks the columns: {', '.join(missing)}")
    for column in columns:
        numbers = pd.to_numeric(table[column], errors="coerce")
        wrong = table[column][numbers.isna() & table[column].notna()]
        if column not in WORDS and len(wrong):
            line = int(wrong.index[0]) + 2
            raise DockctlError(
                f"{path}:{line}: {column}: found the text '{wrong.iloc[0]}', expected a number"
            )
    return table if len(table) else None
