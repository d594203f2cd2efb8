"""Several jobs at once, each a chain of dockctl processes, with a clean way to stop them all."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal

import dockctl
from dockctl.errors import DockctlError
from dockctl.experiments.jobs import Job, Stage
from dockctl.runs.files import writing
from dockctl.runs.lock import exclusive_lock

TAIL_BYTES = 4096
POLL_SECONDS = 0.25

State = Literal["waiting", "working", "done", "failed", "stopped"]


@dataclass(eq=False)
class Progress:
    """How far a job is."""

    job: Job
    state: State = "waiting"
    stage: str = ""
    began: float = 0.0
    reason: str = ""

    @property
    def seconds(self) -> float:
        """Since the stage began."""
        return time.monotonic() - self.began

    def last_line(self) -> str:
        """What the job printed last."""
        try:
            with self.job.log.open("rb") as file:
                file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL_BYTES))
                lines = file.read().decode("utf-8", "replace").splitlines()
        except OSError:
            return ""
        return next((line.strip() for line in reversed(lines) if line.strip()), "")


class Crew:
    """Works through jobs, `hands` at a time.

    Args:
        on_change: called from a worker's thread whenever a job begins a stage or ends.
    """

    def __init__(self, jobs: Sequence[Job], hands: int, on_change: Callable[[Progress], None]) -> None:
        self.progress = [Progress(job) for job in jobs]
        self._hands, self._on_change = hands, on_change
        self._stopping = False
        self._processes: set[subprocess.Popen[bytes]] = set()
        self._lock = threading.RLock()  # a signal may come while we stop

    def work(self, meanwhile: Callable[[], None]) -> None:
        """Do all jobs; `meanwhile` is called a few times a second, from this thread."""
        with ThreadPoolExecutor(self._hands, "job") as pool:
            futures = [pool.submit(self._do, progress) for progress in self.progress]
            while not all(future.done() for future in futures):
                meanwhile()
                time.sleep(POLL_SECONDS)
            meanwhile()
            for future in futures:
                future.result()

    def stop(self) -> None:
        """Ask every process to save and leave, as Ctrl-C does, and begin nothing new; again: at once."""
        with self._lock:
            number = signal.SIGTERM if self._stopping else signal.SIGINT
            self._stopping = True
            for process in self._processes:
                process.send_signal(number)

    @property
    def stopping(self) -> bool:
        return self._stopping

    def _do(self, progress: Progress) -> None:
        try:
            with _log_of(progress.job) as log:
                for stage in _stages(progress.job):
                    if not self._stopping:
                        self._tell(progress, "working", stage.name)
                        code = self._call(stage, log)
                    if self._stopping:
                        return self._tell(progress, "stopped", stage.name)
                    if code or (stage.leaves and not stage.leaves.is_file()):
                        raise DockctlError(progress.last_line())
            self._tell(progress, "done", "")
        except DockctlError as error:
            progress.reason = str(error)
            self._tell(progress, "failed", progress.stage)

    def _tell(self, progress: Progress, state: State, stage: str) -> None:
        progress.state, progress.stage, progress.began = state, stage, time.monotonic()
        self._on_change(progress)

    def _call(self, stage: Stage, log: IO[bytes]) -> int:
        """Run a stage to its end and return its exit status."""
        package = Path(dockctl.__file__).parent.parent
        paths = os.pathsep.join(filter(None, [str(package), os.environ.get("PYTHONPATH")]))
        log.write(f"$ dockctl {shlex.join(stage.arguments)}\n".encode())
        log.flush()
        with self._lock:
            if self._stopping:
                return signal.SIGINT
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "dockctl", *stage.arguments],
                env={"OMP_NUM_THREADS": "1"} | os.environ | {"PYTHONPATH": paths},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                process_group=0,  # Ctrl-C in the terminal reaches us alone, and we pass it on
            )
            self._processes.add(process)
        code = process.wait()
        with self._lock:
            self._processes.discard(process)
        return code


def _stages(job: Job) -> Iterator[Stage]:
    """What is to do, asked for again after every stage."""
    if training := job.training():
        yield training
    if job.training() is not None:
        raise DockctlError(f"{job.folder}: the training left no finished run folder here")
    yield from job.measurements()


@contextmanager
def _log_of(job: Job) -> Iterator[IO[bytes]]:
    """Open the log of a job to append to it, for one process at a time."""
    with writing(job.log):
        job.log.parent.mkdir(parents=True, exist_ok=True)
        file = job.log.open("ab")
    with file, exclusive_lock(job.log):
        yield file
