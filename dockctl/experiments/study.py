"""A study: the scenarios to train, with seeds and settings, the measurements, and the resulting jobs."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PrivateAttr, ValidationError, model_validator

from dockctl.analysis.success_map import SMALL_OFFSET_DEG
from dockctl.errors import DockctlError, nearest
from dockctl.reading import read_json
from dockctl.run_files import (
    DRAWN,
    EVALUATION,
    FAILURES,
    LAST,
    LATENCY,
    LEARNER_JSON,
    MAP,
    PROVENANCE,
    RECORDING,
    RETURNS,
    SCENARIO,
    SCENES,
    STUDY,
    TRANSFER,
    runs_of_seed,
)
from dockctl.runs.directory import RunDirectory
from dockctl.runs.results import measured_policy, policy_hash, read_results, result_stem
from dockctl.scenarios.base import NAME, Count, FieldError, Model, Name
from dockctl.scenarios.catalog import SUFFIXES, display_path, packaged_folder
from dockctl.scenarios.content import first_difference
from dockctl.scenarios.loader import load
from dockctl.scenarios.problems import description, validate
from dockctl.scenarios.schema import PolicyInterface, Scenario
from dockctl.scenarios.yaml_tree import Location, input_error, read_file
from dockctl.sim.checks import load_checked

Probe = Literal["map", "latency", "returns"]
PROBE_STEMS = {"latency": LATENCY, "map": MAP, "returns": RETURNS}


class Experiment(Model):
    """One scenario, trained with the seeds 0 to `seeds` - 1.

    Attributes:
        group: name that selects several experiments together.
        title: short description.
        set: overrides, ``key=value``, as for ``--set``.
        evaluate_on: other scenarios to evaluate the trained policies on.
        probes: further measurements of every policy.
    """

    name: Name
    group: Name
    title: str = ""
    scenario: str
    seeds: Annotated[Count, Field(le=1000)] = 1
    set: tuple[str, ...] = ()
    evaluate_on: tuple[str, ...] = ()
    probes: tuple[Probe, ...] = ()
    _place: str = PrivateAttr("")

    def at(self, location: Location) -> Self:
        """Return the experiment with its location in a study, for errors."""
        located = self.model_copy()
        located._place = f"{location.file}:{location.line}:{location.column}: "
        return located

    def __str__(self) -> str:
        return f"{self._place}experiment {self.name}"

    def overrides(self, seed: int) -> list[str]:
        """Return the overrides of the scenario for one training run."""
        return [*self.set, f"training.seed={seed}"]


class Study(Model):
    """Experiments in the order in which they run.

    Attributes:
        name: folder of its runs and results; by default the name of the file.
    """

    name: Name = "study"
    title: str = ""
    experiments: tuple[Experiment, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _unique_names(self) -> Self:
        names: set[str] = set()
        for index, experiment in enumerate(self.experiments):
            field = f"experiments.{index}.name"
            if experiment.name in (STUDY, SCENES):
                raise FieldError(field, f"every study has a {experiment.name} of its own", "invalid")
            if experiment.name in names:
                raise FieldError(field, f"another experiment is named {experiment.name}", "duplicate")
            names.add(experiment.name)
            for number, setting in enumerate(experiment.set):
                if re.match(r"training\.seed\s*=", setting):
                    field, message = f"experiments.{index}.set.{number}", "is set by 'seeds': 0, 1, ..."
                    raise FieldError(field, f"training.seed {message}", "invalid")
        return self

    def chosen(self, names: Sequence[str]) -> tuple[Experiment, ...]:
        """Return the experiments that `names` select by name or group; all if it is empty.

        Raises:
            DockctlError: a name is unknown.
        """
        known = {name for experiment in self.experiments for name in (experiment.name, experiment.group)}
        for name in names:
            if name not in known:
                message = f"the study has no experiment or group '{name}' (known: {', '.join(sorted(known))})"
                raise DockctlError(message, code="unknown_name", suggestion=nearest(name, known))
        return tuple(e for e in self.experiments if not names or {e.name, e.group} & {*names})


def load_study(source: str) -> Study:
    """Load a study file, or a packaged study by name.

    Raises:
        InputError: lists every problem in the file with its location.
        DockctlError: the study is unknown, or its name cannot be used.
    """
    path = Path(source)
    known = {file.parent.name: file for file in packaged_folder("studies", "studies").glob("*/study.yaml")}
    if path.suffix not in SUFFIXES and not os.path.isfile(path):
        if source not in known:
            message = f"there is no study '{source}' (known: {', '.join(sorted(known))})"
            raise DockctlError(message, code="unknown_name", suggestion=nearest(source, known))
        path = known[source]
    tree = read_file(path, display_path(path))
    study = validate(tree, Study)
    name = study.name if "name" in study.model_fields_set else path.stem
    location = (tree.get("name") or tree).location
    if not re.fullmatch(NAME, name):
        message = f"'{name}' cannot be a folder name; use letters, digits, dots, dashes and underscores"
        raise input_error(location, message, "name")
    if name in known and path.resolve() != known[name].resolve():
        message = f"'{name}' is a packaged study, whose results would be replaced; set another name"
        raise input_error(location, message, "name", "duplicate")
    entries = tree.get("experiments")
    assert entries is not None and isinstance(entries.value, list), "the study is valid"
    located = tuple(
        experiment.at(entry.location)
        for experiment, entry in zip(study.experiments, entries.value, strict=True)
    )
    return study.model_copy(update={"name": name, "experiments": located})


def archived_study(results: Path) -> Study | None:
    """Return the study that is archived with its results, or None if there is none.

    Raises:
        DockctlError: its file is damaged.
    """
    file = results / STUDY
    if not file.is_file():
        return None
    content = read_json(file)
    try:
        return Study.model_validate(content)
    except ValidationError as error:
        (first, *_) = error.errors(include_url=False)
        where, (what, code, _) = ".".join(map(str, first["loc"])), description(first)
        raise DockctlError(f"{file}: {where}: {what}", code=code) from None


def require_own_results(study: Study, results: Path) -> None:
    """Check that no archived experiment has the name of one in the study but other settings.

    Raises:
        DockctlError: one does, because it is from a different study of the same name or was changed.
    """
    archived = archived_study(results)
    settings = {e.name: (e.scenario, e.set) for e in archived.experiments} if archived else {}
    for experiment in study.experiments:
        folder = results / experiment.name
        own = experiment.scenario, experiment.set
        if folder.is_dir() and settings.get(experiment.name, own) != own:
            message = f"{folder}: results of an experiment with a different scenario or settings"
            remedy = "rename the study or the experiment, or move these results away"
            raise DockctlError(f"{message}; {remedy}", code="mismatch")


def with_archived(study: Study, results: Path) -> Study:
    """Return the study with the archived experiments that it does not have itself.

    Raises:
        DockctlError: the file of the archived study is damaged.
    """
    archived, names = archived_study(results), {experiment.name for experiment in study.experiments}
    others = [e for e in archived.experiments if e.name not in names] if archived else []
    kept = [experiment for experiment in others if (results / experiment.name).is_dir()]
    return study.model_copy(update={"experiments": (*kept, *study.experiments)})


@dataclass(frozen=True)
class Stage:
    """One dockctl command.

    Attributes:
        name: shown while it runs.
        arguments: of the command line.
        outputs: JSON files of its results.
        policy: SHA-256 of the policy that it measures.
    """

    name: str
    arguments: tuple[str, ...]
    outputs: tuple[Path, ...] = ()
    policy: str | None = None

    @property
    def is_done(self) -> bool:
        """Whether the results exist, are intact, and come from the current tables and policy."""
        try:
            hashes = {policy_hash(read_results(output)) for output in self.outputs}
        except DockctlError:
            return False
        return bool(hashes) and hashes <= {None, self.policy}


@dataclass(frozen=True, eq=False)
class Job:
    """One training run of an experiment, and the measurements of its policy.

    Attributes:
        scenario: resolved, with the seed.
        transfer: other scenarios to evaluate the policy on, as (source in the study, scenario name).
        folder: of the runs, ``<scenario>/<time>-seed<N>/``, and the log.
        options: options of ``dockctl train``, for new and resumed runs.
        start_options: further options, for new runs only.
    """

    experiment: Experiment
    seed: int
    scenario: Scenario
    transfer: tuple[tuple[str, str], ...]
    folder: Path
    options: tuple[str, ...] = ()
    start_options: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return f"{self.experiment.name} seed {self.seed}"

    @property
    def log(self) -> Path:
        """Output of all stages."""
        return self.folder / f"seed{self.seed}.log"

    def runs(self) -> list[Path]:
        """Return the usable run folders of this job: finished ones first, then the latest."""
        found = self.folder.glob(f"*/[!.]*/{PROVENANCE}")  # a dot marks a folder that is incomplete
        runs = [path.parent for path in sorted(found, reverse=True)]
        usable = [r for r in runs if self.difference(r) is None and (_finished(r) or _resumable(r))]
        return sorted(usable, key=_finished, reverse=True)

    def difference(self, run: Path) -> str | None:
        """Return the first field in which the run's scenario differs from the job's, or None."""
        try:
            return first_difference(self.scenario, load(run / SCENARIO, received=True).scenario)
        except (DockctlError, OSError) as error:
            return str(error).splitlines()[0]

    def mismatched_runs(self) -> Iterator[tuple[Path, str]]:
        """Yield the run folders of this seed that do not match this job, each with the first difference."""
        found = (self.folder.glob(f"*/{name}/{SCENARIO}") for name in runs_of_seed(self.seed))
        for path in sorted(chain.from_iterable(found)):
            if differs := self.difference(path.parent):
                yield path.parent, differs

    def training(self) -> Stage | None:
        """Return the stage that starts or resumes training, or None if training is finished."""
        run = next(iter(self.runs()), None)
        if run is None:
            settings = [word for setting in self.experiment.set for word in ("--set", setting)]
            arguments = [self.experiment.scenario, "--seed", str(self.seed), "--out", str(self.folder)]
            return Stage("train", ("train", *arguments, *settings, *self.start_options, *self.options))
        return None if _finished(run) else Stage("resume", ("train", "--resume", str(run), *self.options))

    def finished(self) -> Path | None:
        """Return the folder of the finished run, if there is one."""
        return next((run for run in self.runs() if _finished(run)), None)

    def measurements(self) -> Iterator[Stage]:
        """Return the remaining stages after training."""
        run = self.runs()[0]
        measured = measured_policy(run)
        stages = (replace(stage, policy=measured) for stage in self._measurements(run))
        return (stage for stage in stages if not stage.is_done)

    def _measurements(self, run: Path) -> Iterator[Stage]:
        policy, recordings = str(run), run / TRANSFER
        yield Stage("evaluate", ("evaluate", policy), (run / f"{EVALUATION}.json",))
        for source, name in self.transfer:
            recorded = ("evaluate", policy, "--scenario", source, "--record")
            outputs = (run / f"{result_stem(EVALUATION, name)}.json", recordings / name / RECORDING)
            yield Stage(f"evaluate on {name}", recorded, outputs)
        yield Stage("plot", ("plot", policy), (run / DRAWN,))
        for probe in self.experiment.probes:
            yield Stage(probe, (probe, policy), (run / f"{PROBE_STEMS[probe]}.json",))
        table = run / f"{MAP}.csv"
        if "map" in self.experiment.probes and table.is_file() and (poses := nearest_failures(table)):
            out = recordings / FAILURES
            starts = [word for pose in poses for word in ("--pose", pose)]
            arguments = ("evaluate", policy, *starts, "--record", str(out))
            yield Stage("record failures", arguments, (out / RECORDING,))


def nearest_failures(table: Path) -> list[str]:
    """Return poses ``x,y,heading`` of the nearest starts that fail as in thesis Figs. 4.39 and 4.40.

    The first one collides, after the intermediate pose if any start does; the second one times out before the
    intermediate pose. Heading offsets above `SMALL_OFFSET_DEG` count only if there are no others.

    Args:
        table: ``map.csv``.
    """
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    collisions = [row for row in rows if row["outcome"] == "collision"]
    kinds = (
        [row for row in collisions if row["phase"] == "1"] or collisions,
        [row for row in rows if row["outcome"] == "timeout" and row["phase"] == "0"],
    )
    nearest = [min(kind, key=_offset) for kind in kinds if kind]
    return [f"{row['x_m']},{row['y_m']},{row['heading_deg']}" for row in nearest]


def _offset(row: dict[str, str]) -> tuple[bool, float, float]:
    dx, dy, turn = (float(row[name]) for name in ("dx_m", "dy_m", "dheading_deg"))
    return abs(turn) > SMALL_OFFSET_DEG, math.hypot(dx, dy), abs(turn)


def make_jobs(
    experiments: Sequence[Experiment],
    out: Path,
    options: Sequence[str] = (),
    start_options: Sequence[str] = (),
    plugin_files: Sequence[Path] = (),
    trust: bool = False,
) -> list[Job]:
    """Return the jobs of the experiments in order, with run folders below `out`.

    Args:
        options, start_options: see `Job`.
        plugin_files, trust: see `dockctl.scenarios.loader.load`.

    Raises:
        DockctlError: a scenario of an experiment is invalid.
    """
    jobs = []
    always = (*options, *(["--trust"] if trust else []))
    first = (*start_options, *(word for file in plugin_files for word in ("--plugin", str(file))))
    for experiment in experiments:
        try:
            loaded = load_checked(
                experiment.scenario,
                overrides=experiment.overrides(0),
                plugin_files=plugin_files,
                trust=trust,
            )
            transfer = _transfer(experiment, loaded.scenario)
        except DockctlError as error:
            lines = (f"{experiment}: {line}" for line in str(error).splitlines())
            raise DockctlError("\n".join(lines), code=error.code) from None
        for seed in range(experiment.seeds):
            overrides = experiment.overrides(seed)
            loaded = load(experiment.scenario, overrides=overrides, plugin_files=plugin_files, trust=trust)
            folder = out / experiment.name
            jobs.append(Job(experiment, seed, loaded.scenario, transfer, folder, always, first))
    return jobs


def _transfer(experiment: Experiment, own: Scenario) -> tuple[tuple[str, str], ...]:
    """Return the other scenarios to evaluate on, as in `Job`; the own scenario is always evaluated.

    Raises:
        DockctlError: a scenario is invalid or does not match the policy, or two have the same name.
    """
    interface, sources = PolicyInterface.of(own), dict[str, str]()
    scenarios = {source: interface.on(load_checked(source).scenario) for source in experiment.evaluate_on}
    for source, scenario in scenarios.items():
        other = sources.setdefault(scenario.name, source)
        if first_difference(scenarios[other], scenario, ignore=["training"]):
            message = f"evaluate_on: {other} and {source} are different scenarios with the name"
            raise DockctlError(f"{message} '{scenario.name}'; rename one of them", code="duplicate")
    return tuple(
        (source, name)
        for name, source in sources.items()
        if first_difference(interface.on(own), scenarios[source], ignore=["training"])
    )


def _finished(run: Path) -> bool:
    return RunDirectory(run).is_finished


def _resumable(run: Path) -> bool:
    return (RunDirectory(run).checkpoint(LAST) / LEARNER_JSON).is_file()
