"""A short training through the command line, shared by the tests of the commands."""

from __future__ import annotations

import json
import shutil
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import IO, Any

import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from dockctl.cli import app
from dockctl.errors import DockctlError
from dockctl.experiments import runner
from dockctl.experiments.jobs import LocalJob
from dockctl.experiments.study import Stage
from dockctl.reports import figures, style

QUICK = (
    "training.boats=2", "training.warmup_steps=20", "training.batch_size=8", "training.steps_per_update=2",
    "training.replay_capacity=1000", "training.evaluate_every_steps=100", "training.hidden_sizes=[16, 8]",
    "training.exploring_starts.steps=20", "task.max_steps=25", "evaluation.random_starts.episodes=3",
    "training.validation.starts=3",
)  # fmt: skip


@dataclass
class Outcome:
    """Exit code and output of a command, and the error that it reported, if any."""

    code: int
    out: str
    err: str
    error: DockctlError | None = None

    @property
    def error_code(self) -> str:
        return self.error.code if self.error else ""


def dockctl(*arguments: object) -> Outcome:
    """Run dockctl in this process."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    cause: BaseException | None = result.exception
    while cause and not isinstance(cause, DockctlError):
        cause = cause.__cause__ or cause.__context__  # what the command line turned into an exit code
    return Outcome(result.exit_code, result.stdout, result.stderr, cause)


class InProcess(LocalJob):
    """A job whose stages run in this process."""

    def _call(self, stage: Stage, log: IO[bytes]) -> int:
        outcome = dockctl(*stage.arguments)
        log.write((outcome.out + outcome.err).encode())
        return outcome.code


class AtOnce(Executor):
    """Calls in this thread, in which alone signals can be handled."""

    def __init__(self, *_: object) -> None:
        pass

    def submit(self, function: Any, /, *args: Any, **named: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(function(*args, **named))
        return future


@pytest.fixture
def one_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a training only the first figure is drawn."""
    drawn = figures.figures
    monkeypatch.setattr(figures, "figures", lambda data: islice(drawn(data), 1))


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch, one_figure: None) -> None:
    """The jobs of studies start no processes, which would each import everything."""
    monkeypatch.setattr(runner, "LocalJob", InProcess)
    monkeypatch.setattr(runner, "ThreadPoolExecutor", AtOnce)


SAVEFIG = Figure.savefig


@pytest.fixture(autouse=True)
def _cheap_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn once, with few pixels: their SVG files are empty."""

    def save(figure: Figure, file: IO[bytes], *, format: str, **options: Any) -> None:
        if format != "svg":
            SAVEFIG(figure, file, format=format, **options)

    monkeypatch.setitem(style.STYLE, "savefig.dpi", 20)
    monkeypatch.setattr(Figure, "savefig", save)


def quick_train(out: Path, *arguments: object) -> Outcome:
    """Train for a few steps into `out`."""
    settings = [word for setting in QUICK for word in ("--set", setting)]
    return dockctl("train", *arguments, "--out", out, *settings)


def only_run(out: Path) -> Path:
    (run,) = out.glob("*/*")
    return run


def forget_interface(run: Path) -> None:
    """Make the card of the best checkpoint one of an earlier version."""
    path = run / "checkpoints" / "best" / "policy.json"
    card = json.loads(path.read_text())
    del card["interface"]
    path.write_text(json.dumps({**card, "format": 1}))


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Outcome]:
    """Run folder and output of a finished training of scenario 1."""
    out = tmp_path_factory.mktemp("runs")
    outcome = quick_train(out, "s1", "--seed", 3, "--steps", 300)
    return only_run(out), outcome


@pytest.fixture
def run(trained: tuple[Path, Outcome], tmp_path: Path) -> Path:
    """A copy of that run folder, to write into."""
    folder = tmp_path / "run"
    shutil.copytree(trained[0], folder, ignore=shutil.ignore_patterns("figures"))
    return folder
