"""Archived runs of the study, and the facts of the thesis that the pages compare them with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml
from pydantic import BaseModel, ConfigDict, model_validator

from dockctl.analysis.episodes import from_initial_poses
from dockctl.analysis.latency import REQUIRED
from dockctl.analysis.success_map import COLUMNS as MAP_COLUMNS
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.experiments.study import Experiment, Study
from dockctl.reading import read_json, reading
from dockctl.reports.plan_view import Track, split_tracks
from dockctl.run_files import (
    EVALUATION,
    LATENCY,
    MAP,
    PROVENANCE,
    RETURNS,
    SCENARIO,
    TIMING_CSV,
    TRANSFER,
    UPDATES_CSV,
    archived_name,
)
from dockctl.runs.reader import Run, read_run, read_table
from dockctl.runs.results import result_stem
from dockctl.runs.tables import OUTCOMES, RECENT
from dockctl.scenarios.schema import Task

SELECTION, TEST = ("pose", "trained"), ("random", "held_out")
"""Kinds of starts of ``dockctl evaluate`` on the training scenario.

Greedy episodes from the first kinds selected the checkpoint and, with a stop rule, ended training. The
others were used for neither. On another scenario every kind is a test.
"""


class Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Cause(Strict):
    """Why a figure of ours differs: a different setting, or an untested hypothesis."""

    setting: str = ""
    hypothesis: str = ""

    @property
    def text(self) -> str:
        return self.setting or f"Hypothesis: {self.hypothesis}"


class FigureFact(Strict):
    """What the thesis reports in a figure, and the function that measures the same in our runs."""

    figure: str
    measure: str
    thesis: str
    cause: str = ""


class ScenarioFact(Strict):
    number: int
    section: str
    start_table: str
    about: str

    @property
    def name(self) -> str:
        return f"s{self.number}"


class Berth(Strict):
    """An untrained berth, as a scenario."""

    name: str
    title: str
    start_table: str


class Weight(Strict):
    """A row of Table 3.5."""

    term: str
    symbol: str
    scenarios_1_2: str
    scenario_3: str


class Claim(Strict):
    claim: str
    where: str
    measure: str
    page: str


class Entry(Strict):
    """Figures or tables of the thesis, where ours are, and how they differ."""

    thesis: str
    shows: str
    page: str
    command: str
    differs: str


class Facts(Strict):
    """``facts.yaml``."""

    seconds_per_step: float
    hours_per_scenario: float
    forward_pass_ms: float
    fails_beyond_m: dict[float, str]
    episodes: dict[str, int]
    mostly_colliding: tuple[int, int]
    scenarios: tuple[ScenarioFact, ...]
    berths: tuple[Berth, ...]
    causes: dict[str, Cause]
    training: dict[str, tuple[FigureFact, ...]]
    maneuvers: dict[str, tuple[FigureFact, ...]]
    weights: tuple[Weight, ...]
    claims: tuple[Claim, ...]
    index: tuple[Entry, ...]

    @model_validator(mode="after")
    def _known_causes(self) -> Facts:
        figures = [fact for facts in (*self.training.values(), *self.maneuvers.values()) for fact in facts]
        if unknown := {fact.cause for fact in figures} - {*self.causes, ""}:
            raise ValueError(f"unknown causes: {', '.join(sorted(unknown))}")
        return self

    def why(self, fact: FigureFact) -> str:
        """Why ours differs; empty where the thesis says nothing to compare with."""
        return self.causes[fact.cause].text if fact.cause else ""


def load_facts() -> Facts:
    text = Path(__file__).with_name("facts.yaml").read_text(encoding="utf-8")
    return Facts.model_validate(yaml.safe_load(text))


@dataclass(frozen=True, eq=False)
class Recording:
    """Greedy episodes with their task and plan view."""

    task: Task
    scene: Scene
    tracks: list[Track]


@dataclass(frozen=True, eq=False)
class ArchivedRun:
    """One archived run; its files are read on first use."""

    folder: Path
    seed: int

    @cached_property
    def run(self) -> Run:
        return read_run(self.folder)

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """Scenario with every default written out."""
        return dict(yaml.safe_load((self.folder / SCENARIO).read_text(encoding="utf-8")))

    @property
    def training(self) -> dict[str, Any]:
        return dict(self.resolved["training"])

    @cached_property
    def provenance(self) -> dict[str, Any]:
        return _json(self.folder / PROVENANCE)

    @property
    def commit(self) -> str:
        """Short commit of dockctl that made the run."""
        return str(self.provenance["git_commit"] or "unknown")[:7]

    @cached_property
    def episodes(self) -> pd.DataFrame:
        if self.run.episodes is None:
            raise DockctlError(f"{self.folder}: episodes.csv is missing", code="not_found")
        return self.run.episodes

    @cached_property
    def timing(self) -> pd.DataFrame:
        return self._table(TIMING_CSV, ("env_steps", "wall_s"))

    @cached_property
    def updates(self) -> pd.DataFrame:
        return self._table(UPDATES_CSV, ("env_steps", "loss", "td_error", "q_mean"))

    @cached_property
    def latency(self) -> dict[str, Any]:
        return _json(self.folder / Path(f"{LATENCY}.json").name)

    @cached_property
    def latency_samples(self) -> pd.DataFrame:
        """Times of single decisions [ms]."""
        return self._table(Path(f"{LATENCY}.csv").name, REQUIRED)[[*REQUIRED]]

    @cached_property
    def map(self) -> pd.DataFrame:
        return self._table(f"{MAP}.csv", (*MAP_COLUMNS, "phase"))

    @cached_property
    def returns(self) -> pd.DataFrame:
        return self._table(f"{RETURNS}.csv", ("distance_unit_m", "return", "intermediate_discount"))

    def evaluation(self, scenario: str = "") -> pd.DataFrame:
        """Episodes of ``dockctl evaluate`` on its own scenario or another."""
        return self._table(
            f"{result_stem(EVALUATION, scenario)}.csv", ("start_kind", "outcome", "time_s", "clearance_m")
        )

    @property
    def recording(self) -> Recording:
        """Greedy episodes of the best checkpoint on its own scenario."""
        return _recording(self.run)

    @property
    def tracks(self) -> list[Track]:
        return self.recording.tracks

    def transfer(self, name: str) -> Recording | None:
        """Recording on another scenario, or of the nearest failures; None where there is none."""
        folder = self.folder / TRANSFER / name
        return _recording(read_run(folder)) if folder.is_dir() else None

    # Quantities in the tables

    @property
    def has_stop_rule(self) -> bool:
        return self.training["stop"] is not None

    @property
    def mastered(self) -> bool:
        """Whether the stop rule ended training."""
        return bool(self.provenance["stop_reason"] == "mastered")

    @property
    def steps(self) -> int:
        """Environment steps of the run."""
        return int(self.timing["env_steps"].iloc[-1])

    @property
    def minutes(self) -> float:
        return float(self.timing["wall_s"].iloc[-1]) / 60

    @property
    def milliseconds_per_step(self) -> float:
        """Wall time of a training step, updates and evaluations included."""
        return 1000 * float(self.timing["wall_s"].iloc[-1]) / self.steps

    @property
    def recent_docked(self) -> int:
        """Docked episodes among the last 100 of training."""
        return int((self.episodes["outcome"].tail(RECENT) == "docked").sum())

    @property
    def greedy(self) -> pd.DataFrame | None:
        """Greedy episodes during training, without those that only select the best policy."""
        table = self.run.evaluations
        return None if table is None else table[table["start_kind"] != "validation"]

    @cached_property
    def first_docked(self) -> int | None:
        """Environment steps at the first greedy evaluation with every episode docked."""
        if self.greedy is None:
            return None
        ends = (self.greedy["outcome"] == "docked").astype(int)
        docked = ends.groupby(self.greedy["env_steps"]).min()
        steps = docked.index[docked.to_numpy() == 1]
        return int(steps.min()) if len(steps) else None

    def best_streak(self) -> int:
        """Longest series of consecutive training episodes from an initial pose that dock."""
        docked = (from_initial_poses(self.episodes)["outcome"] == "docked").to_numpy()
        breaks = np.flatnonzero(~np.concatenate([[False], docked, [False]]))
        return int(np.diff(breaks).max() - 1)

    def outcomes(self, kinds: tuple[str, ...], scenario: str = "") -> dict[str, int] | None:
        """Number of episodes by outcome, from starts of some kinds; None where there are none."""
        table = self.evaluation(scenario)
        rows = table[table["start_kind"].isin(kinds)]
        return count_outcomes(rows) if len(rows) else None

    def of_docked(self, column: str) -> pd.Series:
        """A column of the docked evaluation episodes, without random starts."""
        table = self.evaluation()
        return table.loc[(table["start_kind"] != "random") & (table["outcome"] == "docked"), column]

    def test_starts_by_pose(self) -> Iterator[tuple[int, pd.DataFrame]]:
        """Random starts by the initial pose that they were drawn around, the nearest one."""
        table = self.evaluation()
        rows = table[table["start_kind"] == "random"]
        poses = np.array([(pose.x_m, pose.y_m) for pose in self.run.task.initial])
        offsets = rows[["x_m", "y_m"]].to_numpy(float)[:, None] - poses
        nearest = np.hypot(*np.moveaxis(offsets, -1, 0)).argmin(axis=1)
        return ((index, rows[nearest == index]) for index in range(len(poses)))

    def success_radius(self) -> float | None:
        """Largest distance up to which every free start with a small heading offset docks [m]."""
        free = within_heading(free_starts(self.map), SMALL_OFFSET_DEG)
        return success_radius(free, half_width(self.map))

    def _table(self, name: str, columns: tuple[str, ...]) -> pd.DataFrame:
        table = read_table(self.folder / name, columns)
        if table is None:
            raise DockctlError(f"{self.folder / name}: is missing or has no rows", code="not_found")
        return table


def count_outcomes(rows: pd.DataFrame) -> dict[str, int]:
    """Number of episodes by outcome."""
    counts = rows["outcome"].value_counts()
    return {outcome: int(counts.get(outcome, 0)) for outcome in OUTCOMES}


class Archive:
    """The archived runs of a study by experiment; remembers which experiments were asked for.

    Raises:
        DockctlError: an experiment that is asked for has no archived run.
    """

    def __init__(self, study: Study, folder: Path) -> None:
        self.study = study
        self.used: dict[str, list[ArchivedRun]] = {}
        self._folder = folder
        self._runs = {e.name: self._seeds(e) for e in study.experiments}

    def __getitem__(self, name: str) -> list[ArchivedRun]:
        if not self._runs[name]:
            raise DockctlError(
                f"{self._folder / name}: no archived run; make one with: dockctl reproduce {name}",
                code="not_found",
            )
        self.used[name] = self._runs[name]
        return self._runs[name]

    def group(self, name: str) -> list[Experiment]:
        return [experiment for experiment in self.study.experiments if experiment.group == name]

    def _seeds(self, experiment: Experiment) -> list[ArchivedRun]:
        runs = self._folder / experiment.name
        folders = ((seed, runs / archived_name(seed)) for seed in range(experiment.seeds))
        return [ArchivedRun(folder, seed) for seed, folder in folders if folder.is_dir()]


def _recording(run: Run) -> Recording:
    if run.trajectories is None:
        raise DockctlError(f"{run.folder}: trajectories.csv is missing", code="not_found")
    return Recording(run.task, run.scene, split_tracks(run.trajectories))


def _json(path: Path) -> dict[str, Any]:
    with reading(path):
        return dict(read_json(path))
