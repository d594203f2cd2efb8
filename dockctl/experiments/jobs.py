"""What a study asks for: one job for each experiment and seed, and the stages that it still lacks."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from dockctl.analysis.success_map import SMALL_OFFSET_DEG
from dockctl.errors import DockctlError
from dockctl.experiments.archive import ELSEWHERE, FAILURES
from dockctl.runs.directory import PROVENANCE, SCENARIO, RunDirectory
from dockctl.scenarios.difference import difference
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.study import Experiment
from dockctl.sim.checks import load_checked

TRAJECTORIES = "trajectories.csv"


@dataclass(frozen=True)
class Stage:
    """One call of dockctl: how it is shown, its arguments, and the file that it leaves behind when done."""

    name: str
    arguments: tuple[str, ...]
    leaves: Path | None = None


@dataclass(frozen=True, eq=False)
class Job:
    """One training of an experiment and all that is measured of its policy.

    Attributes:
        scenario: resolved, with the seed.
        elsewhere: the other scenarios to try the policy on, as the study names them, and their own names.
        folder: gets ``<scenario>/<time>-seed<N>/`` and the log.
    """

    experiment: Experiment
    seed: int
    scenario: Scenario
    elsewhere: tuple[tuple[str, str], ...]
    folder: Path

    @property
    def label(self) -> str:
        return f"{self.experiment.name} seed {self.seed}"

    @property
    def log(self) -> Path:
        """Everything that the stages print."""
        return self.folder / f"seed{self.seed}.log"

    def runs(self) -> list[Path]:
        """Folders of this very training that can be used: finished ones first, then the latest."""
        found = []
        for path in sorted(self.folder.glob(f"*/*/{PROVENANCE}"), reverse=True):
            run = path.parent
            if self.difference(run) is None and (_finished(run) or _can_be_taken_up(run)):
                found.append(run)
        return sorted(found, key=_finished, reverse=True)

    def difference(self, run: Path) -> str | None:
        """What tells the run from this job, None where it is the same training."""
        try:
            return difference(self.scenario, load(run / SCENARIO).scenario)
        except (DockctlError, OSError) as error:
            return str(error).splitlines()[0]

    def strangers(self) -> Iterator[tuple[Path, str]]:
        """Folders of this seed that hold another training, each with what differs."""
        for path in sorted(self.folder.glob(f"*/*-seed{self.seed}*/{SCENARIO}")):
            if differs := self.difference(path.parent):
                yield path.parent, differs

    def training(self) -> Stage | None:
        """The stage that makes or finishes the training, None where it is finished."""
        run = next(iter(self.runs()), None)
        if run is None:
            settings = [word for setting in self.experiment.set for word in ("--set", setting)]
            arguments = [self.experiment.scenario, "--seed", str(self.seed), "--out", str(self.folder)]
            return Stage("train", ("train", *arguments, *settings))
        return None if _finished(run) else Stage("resume", ("train", "--resume", str(run)))

    def finished(self) -> Path | None:
        """The folder of the finished training, if there is one."""
        return next((run for run in self.runs() if _finished(run)), None)

    def measurements(self) -> Iterator[Stage]:
        """The stages after the training that are not done yet."""
        run = self.runs()[0]
        return (stage for stage in self._measurements(run) if stage.leaves and not stage.leaves.is_file())

    def _measurements(self, run: Path) -> Iterator[Stage]:
        policy, records = ("--ckpt", str(run)), run / ELSEWHERE
        yield Stage("evaluate", ("evaluate", *policy), run / "evaluation.json")
        for source, name in self.elsewhere:
            there = (*policy, "--scenario", source)
            yield Stage(f"evaluate on {name}", ("evaluate", *there), run / f"evaluation-{name}.json")
            yield Stage(f"record on {name}", ("record", *there), records / name / TRAJECTORIES)
        yield Stage("plot", ("plot", str(run)), run / "figures" / "overview.png")
        latency = run / "figures" / "latency.json"
        probes = {"latency": latency, "map": run / "map.csv", "returns": run / "returns.csv"}
        for probe in self.experiment.probes:
            yield Stage(probe, (probe, *policy), probes[probe])
        charted = "map" in self.experiment.probes and probes["map"].is_file()
        if charted and (failures := nearest_failures(probes["map"])):
            starts = [word for pose in failures for word in ("--pose", pose)]
            out = records / FAILURES
            yield Stage(
                "record failures", ("record", *policy, *starts, "--out", str(out)), out / TRAJECTORIES
            )


def nearest_failures(table: Path) -> list[str]:
    """Poses ``x,y,heading`` of the nearest starts that fail as in Figs. 4.39 and 4.40.

    The first collides, if it can be after it reached the intermediate pose; the second never reaches that
    pose, nor collides. Starts whose heading is off by more than `SMALL_OFFSET_DEG` count only where
    there are no others.
    """
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    collisions = [row for row in rows if row["outcome"] == "collision"]
    kinds = (
        [row for row in collisions if row["phase"] == "1"] or collisions,
        [row for row in rows if row["outcome"] == "timeout" and row["phase"] == "0"],
    )
    nearest = [min(kind, key=_oddity) for kind in kinds if kind]
    return [f"{row['x_m']},{row['y_m']},{row['heading_deg']}" for row in nearest]


def _oddity(row: dict[str, str]) -> tuple[bool, float, float]:
    dx, dy, turn = (float(row[name]) for name in ("dx_m", "dy_m", "dheading_deg"))
    return abs(turn) > SMALL_OFFSET_DEG, math.hypot(dx, dy), abs(turn)


def jobs_of(experiments: Sequence[Experiment], out: Path) -> list[Job]:
    """Return the jobs, experiment by experiment.

    Raises:
        DockctlError: a scenario of an experiment is wrong.
    """
    jobs = []
    for experiment in experiments:
        try:
            load_checked(experiment.scenario, overrides=experiment.overrides(0))
            elsewhere = tuple((source, load(source).scenario.name) for source in experiment.evaluate_on)
        except DockctlError as error:
            lines = str(error).splitlines()
            raise DockctlError("\n".join(f"experiment {experiment.name}: {line}" for line in lines)) from None
        for seed in range(experiment.seeds):
            scenario = load(experiment.scenario, overrides=experiment.overrides(seed)).scenario
            jobs.append(Job(experiment, seed, scenario, elsewhere, out / experiment.name))
    return jobs


def _finished(run: Path) -> bool:
    try:
        return RunDirectory(run).read_json(PROVENANCE).get("finished") is not None
    except DockctlError:
        return False


def _can_be_taken_up(run: Path) -> bool:
    return (RunDirectory(run).checkpoint("last") / "learner.json").is_file()
