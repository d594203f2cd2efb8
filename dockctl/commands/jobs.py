"""What a study asks for: one job for each experiment and seed, and the stages that it still lacks."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dockctl.commands.inputs import load_checked
from dockctl.errors import DockctlError
from dockctl.runs.directory import PROVENANCE, SCENARIO, RunDirectory
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.study import Experiment

WORDS = {"title", "description", "plugins"}
"""Fields of a scenario that a training does not depend on."""


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
            theirs = load(run / SCENARIO).scenario
        except DockctlError as error:
            return str(error).splitlines()[0]
        return _difference(self.scenario.model_dump(exclude=WORDS), theirs.model_dump(exclude=WORDS))

    def strangers(self) -> Iterator[tuple[Path, str]]:
        """Folders of this seed that hold another training, each with what differs."""
        for path in sorted(self.folder.glob(f"*/*-seed{self.seed}*/{SCENARIO}")):
            if difference := self.difference(path.parent):
                yield path.parent, difference

    def training(self) -> Stage | None:
        """The stage that makes or finishes the training, None where it is finished."""
        run = next(iter(self.runs()), None)
        if run is None:
            settings = [word for setting in self.experiment.set for word in ("--set", setting)]
            arguments = [self.experiment.scenario, "--seed", str(self.seed), "--out", str(self.folder)]
            return Stage("train", ("train", *arguments, *settings))
        return None if _finished(run) else Stage("resume", ("train", "--resume", str(run)))

    def measurements(self) -> Iterator[Stage]:
        """The stages after the training that are not done yet."""
        run = self.runs()[0]
        return (stage for stage in self._measurements(run) if stage.leaves and not stage.leaves.is_file())

    def _measurements(self, run: Path) -> Iterator[Stage]:
        policy = ("--ckpt", str(run))
        yield Stage("evaluate", ("evaluate", *policy), run / "evaluation.json")
        for source, name in self.elsewhere:
            elsewhere = ("evaluate", *policy, "--scenario", source)
            yield Stage(f"evaluate on {name}", elsewhere, run / f"evaluation-{name}.json")
        yield Stage("plot", ("plot", str(run)), run / "figures" / "overview.png")
        probes = {"latency": run / "figures" / "latency.json", "map": run / "map.csv"}
        for probe in self.experiment.probes:
            yield Stage(probe, (probe, *policy), probes[probe])


def jobs_of(experiments: Sequence[Experiment], out: Path) -> list[Job]:
    """Return the jobs, first seeds first, so that every experiment shows something early.

    Raises:
        DockctlError: a scenario of an experiment is wrong.
    """
    rounds: list[tuple[int, int, Job]] = []
    for number, experiment in enumerate(experiments):
        try:
            load_checked(experiment.scenario, overrides=experiment.overrides(0))
            elsewhere = tuple((source, load(source).scenario.name) for source in experiment.evaluate_on)
        except DockctlError as error:
            lines = str(error).splitlines()
            raise DockctlError("\n".join(f"experiment {experiment.name}: {line}" for line in lines)) from None
        for seed in range(experiment.seeds):
            scenario = load(experiment.scenario, overrides=experiment.overrides(seed)).scenario
            rounds.append((seed, number, Job(experiment, seed, scenario, elsewhere, out / experiment.name)))
    return [job for _, _, job in sorted(rounds, key=lambda entry: entry[:2])]


def _finished(run: Path) -> bool:
    try:
        return RunDirectory(run).read_json(PROVENANCE).get("finished") is not None
    except DockctlError:
        return False


def _can_be_taken_up(run: Path) -> bool:
    return (RunDirectory(run).checkpoint("last") / "learner.json").is_file()


def _difference(asked: Any, found: Any, path: str = "") -> str | None:
    """The first field in which two trees differ."""
    if isinstance(asked, dict) and isinstance(found, dict):
        fields = (
            _difference(asked.get(key), found.get(key), f"{path}.{key}".lstrip("."))
            for key in {**asked, **found}
        )
        return next((difference for difference in fields if difference), None)
    return None if asked == found else f"{path} is {_short(found)}, asked is {_short(asked)}"


def _short(value: Any) -> str:
    text = json.dumps(value, default=str)
    return text if len(text) <= 40 else f"{text[:37]}..."
