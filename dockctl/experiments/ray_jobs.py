"""Jobs of a study on Ray: each runs on one worker, which sends every change of its run folder to the head.

Head and workers share no files. A worker receives the scenarios of its job, with their local files, and the
head's copy of its run. It sends the run back whenever training has saved, and when a stage ends. If a worker
is lost, another one resumes from the head's copy.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import ray
from ray.exceptions import RayError, RayTaskError

from dockctl import __version__
from dockctl.agents.algorithms import remember_code
from dockctl.cluster import require_version, write_files
from dockctl.errors import DockctlError
from dockctl.experiments.jobs import KilledError, LocalJob, log_line, open_log, remaining
from dockctl.experiments.study import Experiment, Job, Stage
from dockctl.reading import read_bytes
from dockctl.run_files import CHECKPOINTS, LAST, LEARNER_JSON, PROVENANCE, SCENARIO, runs_of_seed
from dockctl.runs.files import exclusive_lock, intact, is_locked, json_text, new_folder, writing
from dockctl.scenarios.content import self_contained
from dockctl.scenarios.loader import load

LOSSES = 3
"""Number of workers lost in a row, without a save in between, after which the job fails."""
POLL_SECONDS = 0.25
FOLDERS = "dockctl-ray-"
"""Prefix of the names of temporary folders."""
SAVED = f"*/*/{CHECKPOINTS}/{LAST}/{LEARNER_JSON}"


@dataclass(frozen=True)
class Assignment:
    """Everything that a worker needs for a job.

    Attributes:
        experiment: the experiment, with the path of its scenario on the worker.
        scenarios: files of its own scenario and of those to evaluate on.
        transfer: names of the scenarios to evaluate on.
        folder: of the runs.
        run: files of the run to resume or to measure, by path below `folder`.
        training: the remaining training stage, as a job on this machine would run it.
    """

    version: str
    experiment: Experiment
    seed: int
    scenarios: tuple[Mapping[str, bytes], ...]
    transfer: tuple[str, ...]
    folder: Path
    run: Mapping[str, bytes]
    training: Stage | None

    @classmethod
    def of(cls, job: Job) -> Assignment:
        """Collect what a worker needs for the remaining stages of a job.

        Raises:
            DockctlError: a file cannot be read.
        """
        others = [load(source).scenario for source, _ in job.transfer]
        run = next(iter(job.runs()), None)
        paths = [path for path in run.rglob("*") if path.is_file()] if run else []
        return cls(
            version=__version__,
            experiment=job.experiment.model_copy(update={"scenario": _place(0), "set": ()}),
            seed=job.seed,
            scenarios=tuple(map(self_contained, [job.scenario, *others])),
            transfer=tuple(name for _, name in job.transfer),
            folder=Path(*(part for part in job.folder.parts if part not in (job.folder.anchor, ".."))),
            run={path.relative_to(job.folder).as_posix(): read_bytes(path) for path in paths},
            training=job.training(),
        )


def _place(number: int) -> str:
    return f"scenarios/{number}/{SCENARIO}"


@dataclass(frozen=True)
class Report:
    """What happened since the last report.

    Attributes:
        stages: the stages that were started.
        output: new text of the log.
        names: files of the runs, if they were read.
        changed: content of the files that are new or have changed.
        ended: True if the job is done, False if it was stopped, the reason if it failed; None if it runs.
    """

    stages: tuple[str, ...]
    output: bytes
    names: frozenset[str] = frozenset()
    changed: Mapping[str, bytes] | None = None
    ended: bool | str | None = None


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Create a folder for the block and remove it afterwards; also remove those of killed workers."""
    for left in Path(tempfile.gettempdir()).glob(f"{FOLDERS}*"):
        if os.path.exists(left / ".lock") and not is_locked(left):
            shutil.rmtree(left, ignore_errors=True)
    root = Path(tempfile.mkdtemp(prefix=FOLDERS))
    try:
        with exclusive_lock(root):
            yield root
    finally:
        shutil.rmtree(root, ignore_errors=True)


class Worker:
    """A job on a machine of the cluster, in a temporary folder."""

    def __init__(self) -> None:
        self._stages: list[str] = []
        self._read_bytes = 0
        self._ended: bool | str | None = None
        self._locked = ExitStack()

    def start(self, given: Assignment) -> None:
        """Write the files of a job and start it.

        Raises:
            DockctlError: this machine has a different version of dockctl.
        """
        require_version(given.version)
        root = self._locked.enter_context(temporary_folder())
        os.chdir(root)  # so that the paths in its results are those of a local job
        self._folder = given.folder
        for number, files in enumerate(given.scenarios):
            write_files(root / _place(number).rpartition("/")[0], files)
        write_files(given.folder, given.run)
        scenarios = [load(_place(number)).scenario for number in range(len(given.scenarios))]
        for scenario in scenarios:
            remember_code(scenario)
        transfer = tuple((_place(number), name) for number, name in enumerate(given.transfer, 1))
        job = Job(given.experiment, given.seed, scenarios[0], transfer, given.folder)
        self._job, self._trainings = LocalJob(job), (job.training(), given.training)
        self._sent = self._stats()
        self._saved = self._saves()
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        try:
            self._ended = self._job.run(self._stages.append)
        except KilledError:  # another worker may have more memory
            os.kill(os.getpid(), signal.SIGKILL)
        except Exception as error:  # the head would wait forever
            self._ended = str(error) if isinstance(error, DockctlError) else repr(error)

    def report(self) -> Report:
        """Return what has happened, with the changed files after a save and between stages."""
        ended, saves = self._ended, self._saves()
        stages, self._stages[:] = tuple(self._stages), []
        output = b""
        with suppress(FileNotFoundError), self._job.job.log.open("rb") as log:
            log.seek(self._read_bytes)
            output = log.read()
        self._read_bytes += len(output)
        here, local = self._trainings
        output = with_log_line(output, here, local) if here and local else output
        if ended is None and saves == self._saved and not stages:
            return Report(stages, output)
        with self._job.paused():  # a consistent state, as after a kill
            self._saved, stats = self._saves(), self._stats()
            changed = {name: self._content(name) for name in stats.keys() - self._same(stats)}
        self._sent = stats
        if ended is not None:
            self._locked.close()
        return Report(stages, output, frozenset(stats), changed, ended)

    def stop(self) -> None:
        """See `RunningJob.stop`."""
        self._job.stop()

    def _content(self, name: str) -> bytes:
        content, (here, local) = (self._folder / name).read_bytes(), self._trainings
        is_provenance = Path(name).name == PROVENANCE
        return with_command(content, here, local) if is_provenance and here and local else content

    def _same(self, stats: Mapping[str, tuple[int, ...]]) -> set[str]:
        return {name for name, stat in stats.items() if self._sent.get(name) == stat}

    def _stats(self) -> dict[str, tuple[int, ...]]:
        return {
            path.relative_to(self._folder).as_posix(): _stat(path)
            for path in self._folder.glob("*/*/**/*")
            if path.is_file()
        }

    def _saves(self) -> list[tuple[int, ...]]:
        found = []
        for path in self._folder.glob(SAVED):
            with suppress(FileNotFoundError):
                found.append(_stat(path))
        return found


def _stat(path: Path) -> tuple[int, ...]:
    stat = path.stat()
    return stat.st_ino, stat.st_size, stat.st_mtime_ns


def with_command(provenance: bytes, here: Stage, local: Stage) -> bytes:
    """Return the provenance of a run with the command line of `local` in place of that of `here`."""
    facts = json.loads(provenance)
    for call in (facts, *facts.get("resumed", [])):
        if call.get("command", [])[1:] == [*here.arguments]:
            call["command"][1:] = local.arguments
    return json_text(facts).encode()


def with_log_line(output: bytes, here: Stage, local: Stage) -> bytes:
    """Return a part of a log with the line of `local` in place of that of `here`."""
    return output.replace(log_line(here), log_line(local))


class RayJob:
    """A job on Ray; a lost worker is replaced."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._stops = 0

    def stop(self) -> None:
        """See `RunningJob`; the thread of `run` forwards it to the worker."""
        self._stops += 1

    def run(self, on_stage: Callable[[str], None]) -> bool:
        """See `RunningJob`."""
        with open_log(self.job) as log:
            self._restore()
            if next(remaining(self.job), None) is None:
                return True
            remember_code(self.job.scenario)  # the runs are this user's own
            losses = 0
            while not self._stops:
                self._saved = False
                try:
                    return self._attempt(on_stage, log)
                except RayTaskError as error:
                    raise DockctlError(str(error.cause).strip().splitlines()[-1]) from None
                except RayError as error:
                    losses = 1 if self._saved else losses + 1
                    reason = str(error).strip().splitlines()[-1].strip()
                    if losses == LOSSES:
                        message = (
                            f"{LOSSES} workers were lost without a save in between, most recently: {reason}"
                        )
                        raise DockctlError(message, code="unavailable") from None
                    with writing(self.job.log):
                        log.write(f"the worker was lost, another one continues: {reason}\n".encode())
            return False

    def _attempt(self, on_stage: Callable[[str], None], log: IO[bytes]) -> bool:
        """Run the job on a new worker until it ends."""
        worker: Any = ray.remote(num_cpus=1)(Worker).remote()
        try:
            given = Assignment.of(self.job)
            known = {*given.run}
            if not self._wait(started := worker.start.remote(given)):
                return False
            ray.get(started)
            stops = 0
            while True:
                while stops < self._stops:
                    worker.stop.remote()
                    stops += 1
                report: Report = ray.get(worker.report.remote())
                for stage in report.stages:
                    on_stage(stage)
                with writing(self.job.log):
                    log.write(report.output)
                if report.changed is not None:
                    receive(self.job.folder, report.names, report.changed, known)
                    known |= report.names
                    self._saved = True
                if isinstance(report.ended, str):
                    raise DockctlError(report.ended)
                if report.ended is not None:
                    return report.ended
                time.sleep(POLL_SECONDS)
        finally:
            ray.kill(worker)

    def _wait(self, result: Any) -> bool:
        """Wait until a worker has started; return False if the job is stopped before."""
        while not ray.wait([result], timeout=POLL_SECONDS)[0]:
            if self._stops:
                return False
        return True

    def _restore(self) -> None:
        """Restore a run folder whose replacement was interrupted."""
        for name in runs_of_seed(self.job.seed):
            for old in self.job.folder.glob(f"*/.{name}.old"):
                run = old.with_name(old.name[1 : -len(".old")])
                if intact(run) == old:
                    old.replace(run)


def receive(folder: Path, names: frozenset[str], changed: Mapping[str, bytes], known: set[str]) -> None:
    """Replace the runs in `folder` with those of a worker, each atomically.

    Args:
        names: all files of the runs, by path below `folder`.
        changed: content of the files that have changed.
        known: files that were sent to or received from this worker.

    Raises:
        DockctlError: a run folder cannot be written, or belongs to a different run.
    """
    for run in sorted({Path(*Path(name).parts[:2]) for name in names}):
        files = [name for name in names if Path(name).is_relative_to(run)]
        if os.path.exists(folder / run) and not any(Path(name).is_relative_to(run) for name in known):
            message = f"{folder / run}: already exists, so the worker's run does not replace it"
            raise DockctlError(message, code="duplicate")
        if not any(name in changed for name in files):
            continue
        with new_folder(folder / run) as new:
            for name in files:
                path = new / Path(name).relative_to(run)
                path.parent.mkdir(parents=True, exist_ok=True)
                if name in changed:
                    path.write_bytes(changed[name])
                else:
                    _link(folder / name, path)


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        shutil.copy2(source, target)
