"""Kill trainings with SIGKILL at random moments and resume them: ``python -m tests.experiments.kills 50``.

Each training must end with the tables and weights of one that was never killed, and lose at most one save
interval at every kill. This process imports dockctl once, and the trainings run in forks of it.
"""

from __future__ import annotations

import json
import mmap
import os
import random
import shutil
import signal
import struct
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from dockctl.agents.progress import Progress
from dockctl.experiments.live import TrainingDisplay
from dockctl.experiments.training import resume, train
from dockctl.run_files import LAST, PROVENANCE, TIMING_CSV
from dockctl.runs.directory import RunDirectory
from tests.commands.conftest import QUICK

STEPS, EVERY = 600, 100
SETTINGS = (*QUICK, "training.hidden_sizes=[32, 32]")
"""A network that does not die by chance, which would end a training."""
EQUAL = (
    "episodes.csv", "updates.csv", "evaluations.csv", "trajectories.csv",
    "checkpoints/best/policy.safetensors", "checkpoints/last/policy.safetensors",
)  # fmt: skip


class Shared:
    """What a training reports to the process that kills it: its steps, and whether it is saving."""

    def __init__(self) -> None:
        self._form, self._memory = struct.Struct("q?"), mmap.mmap(-1, 16)

    def set(self, steps: int, saving: bool) -> None:
        self._form.pack_into(self._memory, 0, steps, saving)

    def get(self) -> tuple[int, bool]:
        steps, saving = self._form.unpack_from(self._memory)
        return steps, saving

    def watch(self) -> None:
        """Report it from now on."""
        show, save = TrainingDisplay.__call__, RunDirectory.new_checkpoint

        def shown(display: TrainingDisplay, progress: Progress) -> None:
            self.set(progress.env_steps, False)
            show(display, progress)

        @contextmanager
        def saved(run: RunDirectory, name: str) -> Iterator[Path]:
            self.set(self.get()[0], True)
            with save(run, name) as folder:
                yield folder
            self.set(self.get()[0], False)

        TrainingDisplay.__call__ = shown  # type: ignore[method-assign]  # replaced on purpose
        RunDirectory.new_checkpoint = saved  # type: ignore[method-assign]  # replaced on purpose


class Killer:
    """Runs one training after the other and counts what happened to them."""

    def __init__(self, root: Path, seed: int) -> None:
        self.root, self.random, self.shared = root, random.Random(seed), Shared()
        self.kills = self.while_saving = self.without_checkpoint = self.most_lost = self.trainings = 0

    def work(self, kills: int) -> None:
        """Start and resume trainings until `kills` of them were killed; every one ends and is checked."""
        while self.kills < kills:
            seed = self.trainings
            self.trainings += 1
            whole, broken = (self.root / f"{seed}-{kind}" for kind in ("whole", "broken"))
            assert self.ends(lambda whole=whole, seed=seed: go_on(whole, seed))
            self.duration_s = wall_s(whole)
            while not self.ends(lambda broken=broken, seed=seed: go_on(broken, seed), self.kills < kills):
                self.count(broken)
            for name in EQUAL:
                assert (only(whole) / name).read_bytes() == (only(broken) / name).read_bytes(), name

    def count(self, out: Path) -> None:
        steps, saving = self.shared.get()
        saved = saved_steps(out)
        self.kills += 1
        self.while_saving += saving
        self.without_checkpoint += not saved
        self.most_lost = max(self.most_lost, steps - saved)
        assert self.most_lost <= EVERY

    def ends(self, work: Callable[[], None], kill: bool = False) -> bool:
        """Run `work` in a fork, and return whether it ended before it was killed, if it was to be."""
        self.shared.set(0, False)
        log = self.root / "log"
        child = os.fork()
        if child == 0:
            try:
                self.shared.watch()
                sys.stdout = log.open("w")
                work()
                sys.stdout.flush()
                os._exit(0)
            except BaseException as error:
                log.write_text("".join(traceback.format_exception(error)))
                os._exit(1)
        if kill:
            self.wait(child)
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert status in (0, -signal.SIGKILL), log.read_text()
        assert status or "warning" not in log.read_text()
        return status == 0

    def wait(self, child: int) -> None:
        """Wait for a random moment of the start, of the training or of a save."""
        kind = self.random.choices(("start", "training", "save"), (1, 5, 4))[0]
        began = {
            "start": lambda steps, saving: True,
            "training": lambda steps, saving: steps > 0,
            "save": lambda steps, saving: saving,
        }[kind]
        if kind == "save":
            time.sleep(self.random.uniform(0, self.duration_s / 2))
        while not began(*self.shared.get()) and not ended(child):
            time.sleep(0.0005)
        longest = 0.02 if kind == "save" else self.duration_s / 2
        time.sleep(self.random.uniform(0, longest))


def ended(child: int) -> bool:
    return os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None


def go_on(out: Path, seed: int) -> None:
    """Start the training, or resume it, or leave it if it is finished."""
    run = next(out.glob("*/*"), None)
    if run and not saved_steps(out):
        shutil.rmtree(run)
        run = None
    if run is None:
        train("s1", seed=seed, steps=STEPS, overrides=SETTINGS, out=out)
    elif not json.loads((run / PROVENANCE).read_text())["finished"]:
        resume(run)


def saved_steps(out: Path) -> int:
    """Return the steps in the last checkpoint; 0 without one."""
    for run in out.glob("*/*"):
        card = RunDirectory(run).checkpoint(LAST) / "policy.json"
        if card.is_file():
            return int(json.loads(card.read_text())["env_steps"])
    return 0


def wall_s(out: Path) -> float:
    """Return the duration of a training, without its start."""
    return float((only(out) / TIMING_CSV).read_text().splitlines()[-1].split(",")[1])


def only(out: Path) -> Path:
    (run,) = out.glob("*/*")
    return run


def main() -> None:
    """Kill as often as the argument says, and print what happened."""
    kills = int(sys.argv[1])
    with tempfile.TemporaryDirectory() as folder:
        killer = Killer(Path(folder), seed=kills)
        killer.work(kills)
    print(
        f"{killer.kills} kills in {killer.trainings} trainings: {killer.while_saving} while saving,"
        f" {killer.without_checkpoint} before the first checkpoint; at most {killer.most_lost} steps lost,"
        f" of {EVERY} between saves; all trainings ended like those that were not killed"
    )


if __name__ == "__main__":
    main()
