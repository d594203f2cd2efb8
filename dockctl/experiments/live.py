"""Progress of a training run: a live panel in a terminal, plain lines otherwise."""

from __future__ import annotations

import time
from collections import deque
from types import TracebackType
from typing import TYPE_CHECKING, Self

from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table

from dockctl.console import count, print_text
from dockctl.runs.tables import RECENT

if TYPE_CHECKING:
    from dockctl.agents.progress import Progress
    from dockctl.scenarios.training import Training

LIVE_SECONDS, PLAIN_SECONDS = 0.25, 8.0
WINDOW_SECONDS = 60.0
"""Window of the speed measurement, which must average over evaluations of several seconds."""


class TrainingDisplay:
    """Shows the progress of a training run; call it after every step.

    Args:
        training: its limits.
        title: of the panel.
        console: a terminal shows a live panel, anything else plain lines.
    """

    def __init__(self, training: Training, title: str, console: Console) -> None:
        self._training, self._title, self._console = training, title, console
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._every = LIVE_SECONDS if self._live else PLAIN_SECONDS
        self._marks: deque[tuple[float, int]] = deque()
        self._shown_at = -float("inf")
        self._evaluated_at = 0

    def __enter__(self) -> Self:
        if self._live:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live:
            self._live.stop()

    def __call__(self, progress: Progress) -> None:
        now = time.monotonic()
        self._show_evaluation(progress)
        if now - self._shown_at < self._every:
            return
        self._shown_at = now
        self._marks.append((now, progress.env_steps))
        while now - self._marks[0][0] > WINDOW_SECONDS:
            self._marks.popleft()
        if self._live:
            self._live.update(self._panel(progress), refresh=True)
        elif len(self._marks) > 1:
            print_text(self._console, " | ".join(self._facts(progress).values()))

    def finish(self, progress: Progress) -> None:
        """Show the end of training, with the last evaluation and the policy that it selected."""
        self._show_evaluation(progress)
        if self._live and self._marks:
            self._live.update(self._panel(progress), refresh=True)

    def _show_evaluation(self, progress: Progress) -> None:
        """Print the latest evaluation, unless already printed."""
        if progress.evaluated_at > self._evaluated_at and progress.evaluation_episodes:
            self._evaluated_at = progress.evaluated_at
            result = f"{progress.evaluation_docked} of {progress.evaluation_episodes}"
            line = f"{progress.evaluated_at:>9,} steps: docked {result}; best {best(progress)}"
            print_text(self._console, line)

    def _facts(self, progress: Progress) -> dict[str, str]:
        """Return the lines of the display, by name."""
        (start, first), (now, last) = self._marks[0], self._marks[-1]
        speed = (last - first) / (now - start) if now > start else 0.0
        total = self._training.total_steps
        left = clock((total - progress.env_steps) / speed) if speed else "-"
        outcomes = ", ".join(f"{count:,} {kind}" for kind, count in sorted(progress.outcomes.items()))
        facts = {
            "steps": f"{progress.env_steps:,} of {total:,} steps",
            "speed": f"{speed:,.0f} steps/s",
            "time": f"{clock(progress.wall_s)}, about {left} to the step limit",
            "docked": f"{progress.recent_docked} of the last {min(RECENT, progress.episodes)} docked",
            "episodes": count(progress.episodes, "episode") + (f": {outcomes}" if outcomes else ""),
        }
        if progress.epsilon is not None:
            facts["epsilon"] = f"epsilon {progress.epsilon:.3f}"
        if progress.loss is not None:
            facts["loss"] = f"loss {progress.loss:.4g} after {progress.updates:,} updates"
        return {**facts, "best": f"best {best(progress)}"}

    def _panel(self, progress: Progress) -> Panel:
        table = Table.grid(padding=(0, 2))
        table.add_column(style="dim")
        table.add_column()
        table.add_row(
            "", ProgressBar(total=self._training.total_steps, completed=progress.env_steps, width=40)
        )
        for name, text in self._facts(progress).items():
            table.add_row(name, text.removeprefix(f"{name} "))
        return Panel(
            table, title=self._title, subtitle="Ctrl-C saves and stops", expand=False, padding=(1, 2)
        )


def best(progress: Progress) -> str:
    """Return the best validation so far, in words."""
    if progress.best is None:
        return "none yet"
    docked, episodes, mean_return = progress.best
    return f"{docked:.0f} of {episodes:.0f} random starts, mean return {mean_return:,.0f}"


def clock(seconds: float) -> str:
    """Return ``m:ss``, or ``h:mm:ss``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
