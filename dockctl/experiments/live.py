"""How a training is shown: live in a terminal, plain lines elsewhere."""

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

from dockctl.analysis.learning import RECENT
from dockctl.console import say

if TYPE_CHECKING:
    from dockctl.agents.progress import Progress
    from dockctl.scenarios.training import Training

LIVE_SECONDS, PLAIN_SECONDS = 0.25, 8.0
WINDOW_SECONDS = 15.0
"""Over how long the speed is measured."""


class TrainingDisplay:
    """Shows the progress of a training; call it after every step.

    Args:
        training: how far it may go.
        title: of the panel.
        console: a terminal gets a live panel, anything else plain lines.
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
        self.show_evaluation(progress)
        if now - self._shown_at < self._every:
            return
        self._shown_at = now
        self._marks.append((now, progress.env_steps))
        while now - self._marks[0][0] > max(WINDOW_SECONDS, 2 * self._every):
            self._marks.popleft()
        if self._live:
            self._live.update(self._panel(progress), refresh=True)
        elif len(self._marks) > 1:
            say(self._console, self._line(progress))

    def show_evaluation(self, progress: Progress) -> None:
        """Print the latest greedy evaluation, unless it was printed before."""
        if progress.evaluated_at > self._evaluated_at:
            self._evaluated_at = progress.evaluated_at
            say(self._console, evaluation_line(progress))

    @property
    def steps_per_second(self) -> float | None:
        (began, first), (now, last) = self._marks[0], self._marks[-1]
        return (last - first) / (now - began) if now > began else None

    def _time_left(self, progress: Progress) -> str:
        speed = self.steps_per_second
        return clock((self._training.total_steps - progress.env_steps) / speed) if speed else "-"

    def _line(self, progress: Progress) -> str:
        return (
            f"{progress.env_steps:>9,} of {self._training.total_steps:,} steps"
            f" | {self.steps_per_second or 0:,.0f} steps/s | at most {self._time_left(progress)} left"
            f" | docked {progress.recent_docked} of the last {min(RECENT, progress.episodes)}"
            f" | {outcomes(progress)} | epsilon {progress.epsilon:.3f}"
            f" | loss {_number(progress.loss)} | best {best(progress)}"
        )

    def _panel(self, progress: Progress) -> Panel:
        total = self._training.total_steps
        facts = Table.grid(padding=(0, 2))
        facts.add_column(style="dim")
        facts.add_column()
        facts.add_row("steps", ProgressBar(total=total, completed=progress.env_steps, width=40))
        speed = self.steps_per_second
        facts.add_row("", f"{progress.env_steps:,} of {total:,}, {f'{speed:,.0f}' if speed else '-'} steps/s")
        facts.add_row("time", f"{clock(progress.wall_s)}, at most {self._time_left(progress)} left")
        docked, of = progress.recent_docked, min(RECENT, progress.episodes)
        color = "green" if of and docked >= 0.95 * of else "yellow" if docked else "white"
        facts.add_row("docked", f"[bold {color}]{docked}[/] of the last {of} episodes")
        facts.add_row("episodes", f"{progress.episodes:,}: {outcomes(progress)}")
        facts.add_row("epsilon", f"{progress.epsilon:.3f}")
        facts.add_row("loss", f"{_number(progress.loss)} after {progress.updates:,} updates")
        facts.add_row("best", best(progress))
        return Panel(
            facts, title=self._title, subtitle="Ctrl-C saves and leaves", expand=False, padding=(1, 2)
        )


def evaluation_line(progress: Progress) -> str:
    """What the latest greedy evaluation came to."""
    return (
        f"{progress.evaluated_at:>9,} steps: the greedy policy docked {progress.evaluation_docked} of "
        f"{progress.evaluation_episodes}; best {best(progress)}"
    )


def best(progress: Progress) -> str:
    """The best greedy evaluation so far."""
    if progress.best is None:
        return "none yet"
    docked, mean_return = progress.best
    return f"{docked:.0f} of {progress.evaluation_episodes} docked, return {mean_return:,.0f}"


def outcomes(progress: Progress) -> str:
    """How the training episodes ended."""
    return (
        ", ".join(f"{count:,} {kind}" for kind, count in sorted(progress.outcomes.items()))
        or "no episode yet"
    )


def clock(seconds: float) -> str:
    """``m:ss``, or ``h:mm:ss``."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"
