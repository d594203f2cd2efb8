"""A training that can no longer write ends with one error, and resumes from its last save afterwards."""

from __future__ import annotations

import os
import resource
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

import pytest

from dockctl.agents.progress import Progress
from dockctl.agents.trainer import Trainer
from dockctl.errors import DockctlError
from dockctl.runs.directory import RunDirectory
from dockctl.scenarios.training import Training
from tests.agents.test_trainer import SETTINGS, TABLES, read_table, trainer_in

EVERY, FAULT, STEPS = 400, 1_000, 2_000
NOBODY = 65_534
TRAINING = Training(
    **{
        **SETTINGS, "hidden_sizes": (16, 16), "replay_capacity": 200, "batch_size": 16, "n_step": 1,
        "evaluate_every_steps": EVERY, "total_steps": STEPS, "stop": None,
    }
)  # fmt: skip


@pytest.fixture
def folder() -> Iterator[Path]:
    """A run folder that any user can enter."""
    path = Path(tempfile.mkdtemp())
    path.chmod(0o755)
    (path / "run").mkdir()
    yield path / "run"
    shutil.rmtree(path)


@contextmanager
def ordinary_user(run: Path) -> Iterator[None]:
    """Permissions apply, even if the tests run as root."""
    root = os.geteuid() == 0
    if root:
        for path in (run.parent, run, *run.rglob("*")):
            os.chown(path, NOBODY, NOBODY)
        os.seteuid(NOBODY)
    try:
        yield
    finally:
        if root:
            os.seteuid(0)


@contextmanager
def full_disk(run: Path) -> Iterator[None]:
    """No file can grow beyond the size of a table plus a part of a row."""
    size = (run / "episodes.csv").stat().st_size + 70
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def read_only(*folders: Path) -> Iterator[None]:
    for each in folders:
        each.chmod(0o555)
    yield
    for each in folders:
        each.chmod(0o755)


@contextmanager
def closed(run: Path) -> Iterator[None]:
    """The tables lose their permissions."""
    tables = [*run.glob("*.csv")]
    for table in tables:
        table.chmod(0)
    yield
    for table in tables:
        table.chmod(0o644)


@contextmanager
def moved(run: Path) -> Iterator[None]:
    run.rename(run.with_name("moved"))
    yield
    shutil.rmtree(run, ignore_errors=True)
    run.with_name("moved").rename(run)


def trainer(folder: Path) -> Trainer:
    return trainer_in(RunDirectory(folder), TRAINING)


@pytest.mark.parametrize(
    "fault",
    [
        full_disk,
        read_only,
        lambda run: read_only(run / "checkpoints"),
        lambda run: read_only(run, run / "checkpoints"),
        closed,
        moved,
    ],
    ids=["full disk", "run read-only", "checkpoints read-only", "both read-only", "tables closed", "moved"],
)
def test_a_training_that_cannot_write_loses_at_most_one_interval(
    folder: Path, fault: Callable[[Path], AbstractContextManager[None]]
) -> None:
    learner, faults = trainer(folder), ExitStack()

    def strike(progress: Progress) -> None:
        if progress.env_steps == FAULT:
            faults.enter_context(ordinary_user(folder))
            faults.enter_context(fault(folder))

    learner.on_progress = strike
    with faults, pytest.raises(DockctlError) as caught:
        learner.run()
    assert caught.value.code == "not_writable"
    assert str(folder) in str(caught.value)
    again = trainer(folder)
    assert again.restore() == []
    assert 0 <= learner.progress.env_steps - again.progress.env_steps <= EVERY
    assert again.run() == "steps"
    for table in TABLES[:2]:
        steps = [int(row["env_steps"]) for row in read_table(folder / table)]
        assert steps == sorted(steps)
        assert steps[-1] > STEPS - EVERY
