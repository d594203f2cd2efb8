"""Environment and training of scenario 3 on 1, 2, 4, … cores of this machine.

    python benchmarks/cores.py                    # minutes; not part of `make bench`

The environment is that of `environment.py`, the training that of `training.py`. Each runs in its own process,
which may use only that many cores. One seed is trained every time: its tables must be the same bytes.
"""

from __future__ import annotations

import hashlib
import multiprocessing
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import bench  # before numpy
import psutil
from environment import stepping
from training import train

from dockctl.compute import usable_cores
from dockctl.envs.vector import DockingVectorEnv
from dockctl.run_files import EPISODES_CSV, UPDATES_CSV

BOATS = (16, 256, 4096)
BOAT_STEPS = 16384  # summed over all boats, in one round
ROUNDS = 3


@contextmanager
def only(cores: int) -> Iterator[None]:
    """Let processes that start meanwhile use only so many cores."""
    process = psutil.Process()
    usable = process.cpu_affinity()
    process.cpu_affinity(usable[:cores])
    try:
        yield
    finally:
        process.cpu_affinity(usable)


def steps_per_second() -> list[float]:
    """Measure environments of each number of boats on the cores of this process."""
    cases = {}
    for boats in BOATS:
        env = DockingVectorEnv("s3", boats, exploring=True)
        env.reset(seed=0)
        steps = BOAT_STEPS // boats
        cases[str(boats)] = bench.Case(stepping(env, steps), steps * boats, cores=2)  # wall-clock time
    times = bench.alternate(cases, ROUNDS, "environments")
    return [1 / bench.summary(seconds)["median"] for seconds in times.values()]


def training() -> dict[str, Any]:
    """Train seed 0 to mastery, and add a hash of its tables to the result."""
    with tempfile.TemporaryDirectory() as folder:
        run = train("s3", 0, Path(folder))
        tables = [path for name in (EPISODES_CSV, UPDATES_CSV) for path in Path(folder).glob(f"*/*/{name}")]
        return {**run, "tables": hashlib.sha256(b"".join(path.read_bytes() for path in tables)).hexdigest()}


def main() -> None:
    report = bench.Report("cores", "Use of several cores")
    points = []
    for cores in (2**power for power in range(usable_cores().bit_length())):
        with only(cores), multiprocessing.get_context("spawn").Pool(1) as process:
            points.append({"cores": cores, "stepping": process.apply(steps_per_second), **training()})
        bench.console.print(points[-1])
    report.facts = {"boats": list(BOATS), "points": points}
    report.targets = [
        bench.Target(
            "trainings on more cores that differ", len({point["tables"] for point in points}) - 1, at_most=0
        )
    ]
    report.write()


if __name__ == "__main__":
    main()
