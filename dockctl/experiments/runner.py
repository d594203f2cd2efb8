"""Run a study: jobs in parallel, a progress display, and the archive of results."""

from __future__ import annotations

import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from dockctl.compute import usable_cores
from dockctl.console import command_line, count, print_text
from dockctl.errors import DockctlError
from dockctl.experiments.archive import archive
from dockctl.experiments.interrupt import on_interrupt
from dockctl.experiments.jobs import LocalJob, RunningJob, last_line
from dockctl.experiments.live import clock
from dockctl.experiments.study import Job, load_study, make_jobs, require_own_results, with_archived
from dockctl.run_files import STUDY
from dockctl.runs.files import require_writable, write_json

POLL_SECONDS = 0.25
PLAIN_SECONDS = 60.0

State = Literal["waiting", "working", "done", "failed", "stopped"]
Ending = Literal["done", "failed", "interrupted"]


def run_study(
    source: str,
    names: Sequence[str],
    out: Path,
    results: Path,
    workers: int | None = None,
    on: str | None = None,
) -> Ending:
    """Run the remaining stages of a study and archive the finished runs.

    Args:
        source: study file, or name of a packaged study.
        names: experiments or groups; all if empty.
        out: folder of the runs, ``<study>/<experiment>/<scenario>/<time>-seed<N>/``.
        results: folder of the archive, ``<study>/<experiment>/seed<N>/``.
        workers: number of parallel jobs; one per core by default.
        on: where they run, see `dockctl.cluster.connected`; by default on this machine, without Ray.

    Raises:
        DockctlError: the study or one of its scenarios is invalid, the archive is from a different study, a
            run is damaged, a folder cannot be written, or Ray cannot be used.
    """
    study = load_study(source)
    experiments = study.chosen(names)
    out, results = out / study.name, results / study.name
    for folder in (out, results):
        require_writable(folder)
    jobs = make_jobs(experiments, out)
    require_own_results(study, results)
    console = Console()
    ending, done = run_jobs(console, jobs, workers, on)
    if ending != "interrupted":
        archived = [
            archive(finished, results, job.experiment.name, job.seed)
            for job in done
            if (finished := job.finished())
        ]
        if archived:
            write_json(results / STUDY, with_archived(study, results).model_dump(mode="json"))
        print_text(console, f"{count(len(archived), 'run')} archived in {results}")
    return ending


def run_jobs(
    console: Console, jobs: Sequence[Job], workers: int | None = None, on: str | None = None
) -> tuple[Ending, list[Job]]:
    """Run the remaining stages of jobs, report progress, and return the ending and the finished jobs.

    Args:
        workers, on: see `run_study`.
    """
    for job in jobs:
        for run, difference in job.mismatched_runs():
            print_text(console, f"note: {run} is not a run of {job.label}: {difference}", "yellow")
    with ExitStack() as stack:
        cores: int = usable_cores()
        place: Callable[[Job], RunningJob] = LocalJob
        if on is not None:
            from dockctl.cluster import connected

            cores = stack.enter_context(connected(on))
            from dockctl.experiments.ray_jobs import RayJob

            place = RayJob
        number = min(workers or cores, len(jobs))
        runner = JobRunner(jobs, number, lambda progress: display.report(progress), place)
        display = Display(console, runner)
        with display.shown(), on_interrupt(runner.stop):
            runner.work(display.refresh)
    ending = _report_ending(console, runner)
    return ending, [progress.job for progress in runner.progress if progress.state == "done"]


@dataclass(eq=False)
class Progress:
    """State of a job."""

    job: Job
    state: State = "waiting"
    stage: str = ""
    began: float = 0.0
    reason: str = ""

    @property
    def seconds(self) -> float:
        """Duration of the stage so far."""
        return time.monotonic() - self.began

    def last_line(self) -> str:
        """Return the last line of the job's output."""
        return last_line(self.job.log)


class JobRunner:
    """Runs jobs, each in its own thread.

    Args:
        workers: number of jobs that run at the same time.
        on_change: called from a thread whenever a job starts a stage or ends.
        place: where they run.
    """

    def __init__(
        self,
        jobs: Sequence[Job],
        workers: int,
        on_change: Callable[[Progress], None],
        place: Callable[[Job], RunningJob] = LocalJob,
    ) -> None:
        self.progress = [Progress(job) for job in jobs]
        self._workers, self._on_change, self._place = workers, on_change, place
        self._stopping = False
        self._running: set[RunningJob] = set()
        self._lock = threading.RLock()  # a signal may arrive inside stop()

    def work(self, poll: Callable[[], None]) -> None:
        """Run all jobs; `poll` is called a few times a second from this thread."""
        with ThreadPoolExecutor(self._workers, "job") as pool:
            futures = [pool.submit(self._run, progress) for progress in self.progress]
            while not all(future.done() for future in futures):
                poll()
                time.sleep(POLL_SECONDS)
            poll()
            for future in futures:
                future.result()

    def stop(self) -> None:
        """Start no further jobs and interrupt the running ones; on the second call, terminate them."""
        with self._lock:
            self._stopping = True
            for job in self._running:
                job.stop()

    @property
    def stopping(self) -> bool:
        return self._stopping

    def _run(self, progress: Progress) -> None:
        with self._lock:
            if self._stopping:  # before this job was started
                return
            job = self._place(progress.job)
            self._running.add(job)
        try:
            is_done = job.run(lambda stage: self._change(progress, "working", stage))
            self._change(progress, "done" if is_done else "stopped", "" if is_done else progress.stage)
        except DockctlError as error:
            progress.reason = str(error)
            self._change(progress, "failed", progress.stage)
        finally:
            with self._lock:
                self._running.discard(job)

    def _change(self, progress: Progress, state: State, stage: str) -> None:
        progress.state, progress.stage, progress.began = state, stage, time.monotonic()
        self._on_change(progress)


class Display:
    """A live table of the running jobs in a terminal, plain lines in a file or pipe."""

    def __init__(self, console: Console, runner: JobRunner) -> None:
        self._console, self._runner = console, runner
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._printed_at = time.monotonic()

    @contextmanager
    def shown(self) -> Iterator[None]:
        """Show the live table inside the block, and erase it afterwards."""
        with ExitStack() as stack:
            if self._live:
                stack.enter_context(self._live)
                stack.callback(self._live.update, Text(), refresh=True)
            yield

    def report(self, progress: Progress) -> None:
        """Print that a job started a stage or ended; in a terminal, only that it ended."""
        label = progress.job.label
        if progress.state == "working":
            if not self._live:
                print_text(self._console, f"{label}: {progress.stage}")
        elif progress.state == "failed":
            parts = (f"{label}:", progress.stage, "failed:", progress.reason, f"(see {progress.job.log})")
            print_text(self._console, " ".join(filter(None, parts)), "red")
        else:
            print_text(
                self._console, f"{label}: {progress.state}", "green" if progress.state == "done" else ""
            )

    def refresh(self) -> None:
        """Show the progress of the running jobs."""
        working = [progress for progress in self._runner.progress if progress.state == "working"]
        if self._live:
            self._live.update(self._table(working), refresh=True)
        elif time.monotonic() - self._printed_at > PLAIN_SECONDS:
            self._printed_at = time.monotonic()
            for progress in working:
                facts = (progress.job.label, progress.stage, clock(progress.seconds), progress.last_line())
                print_text(self._console, " | ".join(facts))

    def _table(self, working: Sequence[Progress]) -> Group:
        table = Table.grid(padding=(0, 2), expand=True)
        for style in ("bold", "cyan", "dim"):
            table.add_column(no_wrap=True, style=style)
        table.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
        for progress in working:
            last_line = Text(progress.last_line())
            table.add_row(progress.job.label, progress.stage, clock(progress.seconds), last_line)
        hint = "saving and exiting ..." if self._runner.stopping else "Ctrl-C saves and exits"
        return Group(table, Text(f"{_counts(self._runner)} | {hint}", style="dim"))


def _counts(runner: JobRunner) -> str:
    counts = Counter(progress.state for progress in runner.progress)
    return ", ".join(f"{count} {state}" for state, count in counts.items())


def _report_ending(console: Console, runner: JobRunner) -> Ending:
    command = command_line(*sys.argv[1:])
    if runner.stopping and any(progress.state != "done" for progress in runner.progress):
        print_text(console, f"Interrupted: {_counts(runner)}. All runs are saved. To resume:\n  {command}")
        return "interrupted"
    failed = [progress for progress in runner.progress if progress.state == "failed"]
    print_text(console, f"{len(runner.progress) - len(failed)} of {count(len(runner.progress), 'job')} done.")
    for progress in failed:
        print_text(console, f"failed: {progress.job.label}: {progress.reason}", "red")
    if failed:
        print_text(console, f"After fixing this, resume with:\n  {command}")
    return "failed" if failed else "done"
