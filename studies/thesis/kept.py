"""Kept runs of a study, and what is measured on each of them."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from dockctl.analysis.latency import PARTS
from dockctl.analysis.learning import RECENT, from_initial_poses
from dockctl.analysis.success_map import COLUMNS as MAP_COLUMNS
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.analysis.trajectories import Track, tracks_of
from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.runs.directory import PROVENANCE, SCENARIO, TRANSFER
from dockctl.runs.reader import Run, read_run, read_table
from dockctl.scenarios.schema import Task
from dockctl.scenarios.study import Experiment, Study

EVALUATION = ("start_kind", "outcome", "time_s", "clearance_m", "control_changes", "path_length_m")
RETURNS = ("distance_unit_m", "return", "gate_discount")


@dataclass(frozen=True, eq=False)
class Kept:
    """One kept run, read when asked."""

    folder: Path
    seed: int

    @cached_property
    def run(self) -> Run:
        return read_run(self.folder)

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """Its scenario, with every default written out."""
        return dict(yaml.safe_load((self.folder / SCENARIO).read_text(encoding="utf-8")))

    @property
    def training(self) -> dict[str, Any]:
        """The section of that name of its scenario."""
        return dict(self.resolved["training"])

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Its provenance."""
        return _json(self.folder / PROVENANCE)

    @cached_property
    def episodes(self) -> pd.DataFrame:
        if self.run.episodes is None:
            raise DockctlError(f"{self.folder}: episodes.csv is missing")
        return self.run.episodes

    @cached_property
    def timing(self) -> pd.DataFrame:
        return _required(self.folder / "timing.csv", ("env_steps", "wall_s"))

    @cached_property
    def updates(self) -> pd.DataFrame:
        return _required(self.folder / "updates.csv", ("env_steps", "loss", "td_error", "q_mean"))

    @cached_property
    def latency(self) -> dict[str, Any] | None:
        path = self.folder / "latency.json"
        return _json(path) if path.exists() else None

    @cached_property
    def samples(self) -> pd.DataFrame | None:
        """Times of single decisions [ms]."""
        table = read_table(self.folder / "latency.csv", tuple(PARTS))
        return None if table is None else table[[*PARTS]]

    @cached_property
    def map(self) -> pd.DataFrame | None:
        return read_table(self.folder / "map.csv", (*MAP_COLUMNS, "phase"))

    @cached_property
    def returns(self) -> pd.DataFrame | None:
        return read_table(self.folder / "returns.csv", RETURNS)

    def evaluation(self, scenario: str = "") -> pd.DataFrame | None:
        """Episodes of ``dockctl evaluate``, on its own scenario or another."""
        stem = f"evaluation-{scenario}" if scenario else "evaluation"
        return read_table(self.folder / f"{stem}.csv", EVALUATION)

    def course(self, name: str) -> Course | None:
        """What was recorded elsewhere under that name."""
        return read_course(self.folder / TRANSFER / name)

    @property
    def tracks(self) -> list[Track]:
        """The greedy episodes of its best policy from the test poses."""
        return [] if self.run.trajectories is None else tracks_of(self.run.trajectories)

    # What the tables of the page show

    @property
    def finished(self) -> bool:
        return self.facts["finished"] is not None

    @property
    def has_stop_rule(self) -> bool:
        """Whether its training was to end once the task is mastered."""
        return self.training["stop"] is not None

    @property
    def mastered(self) -> bool:
        return bool(self.facts["stop_reason"] == "mastered")

    @property
    def steps(self) -> int:
        return int(self.timing["env_steps"].iloc[-1])

    @property
    def minutes(self) -> float:
        return float(self.timing["wall_s"].iloc[-1]) / 60

    @property
    def recent_docked(self) -> int:
        """Docked of the last 100 training episodes."""
        return int((self.episodes["outcome"].tail(RECENT) == "docked").sum())

    @cached_property
    def first_docked(self) -> int | None:
        """Environment steps at the first greedy evaluation that docks from every test pose."""
        if self.run.evaluations is None:
            return None
        ends = (self.run.evaluations["outcome"] == "docked").astype(int)
        docked = ends.groupby(self.run.evaluations["env_steps"]).min()
        steps = docked.index[docked.to_numpy() == 1]
        return int(steps.min()) if len(steps) else None

    def ended(self, kind: str, scenario: str = "") -> tuple[int, int] | None:
        """Docked and all episodes of an evaluation that began at one kind of start; None if not evaluated."""
        table = self.evaluation(scenario)
        if table is None or not (table["start_kind"] == kind).any():
            return None
        rows = table[table["start_kind"] == kind]
        return int((rows["outcome"] == "docked").sum()), len(rows)

    def of_docked(self, column: str, scenario: str = "") -> pd.Series:
        """A column of the episodes from test poses that docked."""
        table = self.evaluation(scenario)
        if table is None:
            return pd.Series(dtype=float)
        rows = table[(table["start_kind"] != "random") & (table["outcome"] == "docked")]
        return rows[column]

    def radius(self) -> float | None:
        """Success radius over headings at most `SMALL_OFFSET_DEG` off [m]."""
        if self.map is None:
            return None
        free = within_heading(free_starts(self.map), SMALL_OFFSET_DEG)
        return success_radius(free, half_width(self.map))

    def best_streak(self) -> int:
        """Longest run of training episodes from an initial pose that docked one after the other."""
        docked = (from_initial_poses(self.episodes)["outcome"] == "docked").to_numpy()
        breaks = np.flatnonzero(~np.concatenate([[False], docked, [False]]))
        return int(np.diff(breaks).max() - 1)


@dataclass(frozen=True, eq=False)
class Course:
    """Greedy episodes that were recorded apart from the training: task, plan view and rows."""

    task: Task
    scene: Scene
    trajectories: pd.DataFrame

    @property
    def tracks(self) -> list[Track]:
        return tracks_of(self.trajectories)


def read_course(folder: Path) -> Course | None:
    """Read what was recorded in a folder, None where there is nothing."""
    if not folder.is_dir():
        return None
    run = read_run(folder)
    assert run.trajectories is not None  # without episodes, read_run asks for them
    return Course(run.task, run.scene, run.trajectories)


Kepts = Mapping[str, list[Kept]]


def read_results(study: Study, results: Path) -> Kepts:
    """Return the kept runs of every experiment by seed; one without any, or unknown, has an empty list."""
    return defaultdict(list, {e.name: _seeds(e, results / e.name) for e in study.experiments})


def _seeds(experiment: Experiment, folder: Path) -> list[Kept]:
    seeds = range(experiment.seeds)
    return [Kept(path, seed) for seed in seeds if (path := folder / f"seed{seed}").is_dir()]


def _required(path: Path, columns: tuple[str, ...]) -> pd.DataFrame:
    table = read_table(path, columns)
    if table is None:
        raise DockctlError(f"{path} is missing or has no rows")
    return table


def _json(path: Path) -> dict[str, Any]:
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise DockctlError(f"{path}: cannot be read: {error}") from None
