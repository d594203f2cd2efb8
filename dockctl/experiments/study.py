"""Carry out a study: show how far its jobs are, and leave cleanly when asked to."""

from __future__ import annotations

import shlex
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from dockctl.console import say
from dockctl.experiments.interrupt import on_interrupt
from dockctl.experiments.jobs import jobs_of
from dockctl.experiments.live import clock
from dockctl.experiments.runner import Crew, Progress
from dockctl.runs.directory import require_writable
from dockctl.scenarios.study import load_study

PLAIN_SECONDS = 60.0

Ending = Literal["done", "failed", "interrupted"]


def carry_out(source: str, names: Sequence[str], out: Path, hands: int) -> Ending:
    """Do what the experiments `names` of a study still lack, `hands` jobs at a time.

    Raises:
        DockctlError: the study or one of its scenarios is wrong, or `out` cannot be written to.
    """
    experiments = load_study(source).chosen(names)
    require_writable(out)
    jobs = jobs_of(experiments, out)
    console = Console()
    for job in jobs:
        for run, difference in job.strangers():
            say(console, f"note: {run} is not taken for {job.label}: {difference}", "yellow")
    crew = Crew(jobs, min(hands, len(jobs)), lambda progress: display.tell(progress))
    with Display(console, crew) as display, on_interrupt(crew.stop):
        crew.work(display.show)
    return _tell_ending(console, crew)


class Display:
    """Shows a line for each running job in a terminal, and plain lines elsewhere."""

    def __init__(self, console: Console, crew: Crew) -> None:
        self._console, self._crew = console, crew
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._shown_at = time.monotonic()

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._live.update(Text(), refresh=True)
            self._live.stop()

    def tell(self, progress: Progress) -> None:
        """Print that a job began a stage or ended; in a terminal only the endings."""
        label = progress.job.label
        if progress.state == "working":
            if not self._live:
                say(self._console, f"{label}: {progress.stage}")
        elif progress.state == "failed":
            words = (f"{label}:", progress.stage, "failed:", progress.reason, f"(see {progress.job.log})")
            say(self._console, " ".join(filter(None, words)), "red")
        else:
            say(self._console, f"{label}: {progress.state}", "green" if progress.state == "done" else "")

    def show(self) -> None:
        """Show how far the running jobs are."""
        working = [progress for progress in self._crew.progress if progress.state == "working"]
        if self._live:
            self._live.update(self._board(working), refresh=True)
        elif time.monotonic() - self._shown_at > PLAIN_SECONDS:
            self._shown_at = time.monotonic()
            for progress in working:
                facts = (progress.job.label, progress.stage, clock(progress.seconds), progress.last_line())
                say(self._console, " | ".join(facts))

    def _board(self, working: Sequence[Progress]) -> Group:
        table = Table.grid(padding=(0, 2), expand=True)
        for style in ("bold", "cyan", "dim"):
            table.add_column(no_wrap=True, style=style)
        table.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
        for progress in working:
            table.add_row(
                progress.job.label, progress.stage, clock(progress.seconds), Text(progress.last_line())
            )
        hint = "saving and leaving ..." if self._crew.stopping else "Ctrl-C saves and leaves"
        return Group(table, Text(f"{_counts(self._crew)} | {hint}", style="dim"))


def _counts(crew: Crew) -> str:
    counts = Counter(progress.state for progress in crew.progress)
    return ", ".join(f"{count} {state}" for state, count in counts.items())


def _tell_ending(console: Console, crew: Crew) -> Ending:
    again = f"dockctl {shlex.join(sys.argv[1:])}"
    if crew.stopping and any(progress.state != "done" for progress in crew.progress):
        say(console, f"Interrupted: {_counts(crew)}. Trainings are saved. To go on:\n  {again}")
        return "interrupted"
    failed = [progress for progress in crew.progress if progress.state == "failed"]
    say(console, f"{len(crew.progress) - len(failed)} of {len(crew.progress)} jobs done.")
    for progress in failed:
        say(console, f"failed: {progress.job.label}: {progress.reason}", "red")
    if failed:
        say(console, f"When that is put right:\n  {again}")
    return "failed" if failed else "done"
