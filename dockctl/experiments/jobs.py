"""How a job of a study runs: as processes on this machine, or on Ray (`dockctl.experiments.ray_jobs`)."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Protocol

import dockctl
from dockctl.console import command_line
from dockctl.errors import DockctlError
from dockctl.experiments.study import Job, Stage
from dockctl.runs.files import exclusive_lock, writing

TAIL_BYTES = 4096
# The process must not outlive its parent, and Ray blocks SIGINT in the processes that it starts.
LAUNCH = """
import ctypes, os, signal, sys
signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
if sys.platform == "linux":
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    if os.getppid() != int(sys.argv[1]):
        sys.exit(1)
os.execv(sys.executable, [sys.executable, *sys.argv[2:]])
"""


class KilledError(DockctlError):
    """A process of a job was killed, by the system or by a user."""

    code = "unavailable"


class RunningJob(Protocol):
    """A job and the place where it runs."""

    def run(self, on_stage: Callable[[str], None]) -> bool:
        """Run the remaining stages; return True when they are done, or False if stopped before.

        Args:
            on_stage: called with the name of every stage that starts.

        Raises:
            DockctlError: a stage failed.
        """

    def stop(self) -> None:
        """Start no further stage and interrupt the current one; on the second call, terminate it."""


def log_line(stage: Stage) -> bytes:
    """Return the line of a log that precedes the output of a stage."""
    return f"$ {command_line(*stage.arguments)}\n".encode()


class LocalJob:
    """A job on this machine; each stage is a process."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._stopped = False
        self._process: subprocess.Popen[bytes] | None = None
        self._lock = threading.RLock()  # a signal may arrive inside stop()

    def run(self, on_stage: Callable[[str], None]) -> bool:
        """See `RunningJob`."""
        with open_log(self.job) as log:
            for stage in remaining(self.job):
                on_stage(stage.name)
                code = self._call(stage, log)
                if code is None:
                    return False
                if code == -signal.SIGKILL:
                    raise KilledError(f"{stage.name} was killed; did the machine run out of memory?")
                if code or (stage.outputs and not stage.is_done):
                    raise DockctlError(last_line(self.job.log))
        return True

    def stop(self) -> None:
        """See `RunningJob`."""
        with self._lock:
            number = signal.SIGTERM if self._stopped else signal.SIGINT
            self._stopped = True
            if self._process:
                self._process.send_signal(number)

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Suspend the process inside the block, in which its files do not change."""
        with self._lock:
            process = self._process
            if process is not None:
                process.send_signal(signal.SIGSTOP)
                with suppress(ChildProcessError):  # it has ended
                    os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
            try:
                yield
            finally:
                if process is not None:
                    process.send_signal(signal.SIGCONT)

    def _call(self, stage: Stage, log: IO[bytes]) -> int | None:
        """Run a stage and return its exit status, or None if the job was stopped."""
        package = Path(dockctl.__file__).parent.parent
        paths = os.pathsep.join(filter(None, [str(package), os.environ.get("PYTHONPATH")]))
        with writing(Path(log.name)):
            log.write(log_line(stage))
        command = [sys.executable, "-P", "-c", LAUNCH, str(os.getpid())]
        with self._lock:
            if self._stopped:
                return None
            self._process = process = subprocess.Popen(
                [*command, "-P", "-m", "dockctl", *stage.arguments],
                env={"OMP_NUM_THREADS": "1"} | os.environ | {"PYTHONPATH": paths},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                process_group=0,  # Ctrl-C in the terminal reaches this process only, and stop() forwards it
            )
        code = process.wait()
        with self._lock:
            self._process = None
            return None if self._stopped else code


def remaining(job: Job) -> Iterator[Stage]:
    """Yield the remaining stages of a job; what remains is determined again after training.

    Raises:
        DockctlError: training left no finished run folder.
    """
    if training := job.training():
        yield training
    if job.training() is not None:
        raise DockctlError(f"{job.folder}: training ended without a finished run folder")
    yield from job.measurements()


@contextmanager
def open_log(job: Job) -> Iterator[IO[bytes]]:
    """Open the log of a job for appending, for one process at a time.

    Raises:
        DockctlError: it cannot be written, or another process has it open.
    """
    with writing(job.log):
        job.log.parent.mkdir(parents=True, exist_ok=True)
        file = job.log.open("ab", buffering=0)
    with file, exclusive_lock(job.log):
        yield file


def last_line(log: Path) -> str:
    """Return the last nonempty line of a log, or an empty string."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, file.seek(0, os.SEEK_END) - TAIL_BYTES))
            lines = file.read().decode("utf-8", "replace").splitlines()
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")
