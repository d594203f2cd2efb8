"""The environment at 1 to 4,096 boats: steps a second, memory, and one step through Gymnasium.

    python benchmarks/environment.py

Boats act at random and begin as in training, so all the parts of the marina are visited. Full LiDAR.
"""

from __future__ import annotations

import argparse
import gc
import os
import statistics
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import bench  # before numpy
import gymnasium
import numpy as np

import dockctl.envs  # noqa: F401  registers the environments
from dockctl.envs.vector import DockingVectorEnv
from dockctl.sim.lidar import thread_count

BOATS = (1, 16, 256, 4096)
BOAT_STEPS = 4096  # of all boats together, timed in one round


def stepping(env: DockingVectorEnv, steps: int) -> Callable[[], None]:
    """Return work that steps all the boats so many times, with actions drawn beforehand."""
    actions = np.random.default_rng(1).integers(env.single_action_space.n, size=(steps, env.num_envs))

    def work() -> None:
        for action in actions:
            env.step(action)

    return work


def stepping_cases(envs: dict[int, DockingVectorEnv], cores: int) -> dict[str, bench.Case]:
    """Return the case of a step of one boat in each environment; `cores` chooses the clock."""
    cases = {}
    for boats, env in envs.items():
        steps = BOAT_STEPS // boats
        cases[f"{boats:,} boats"] = bench.Case(stepping(env, steps), steps * boats, cores)
    return cases


def resident_bytes() -> int:
    """Return the memory that this process holds."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def state_bytes(env: DockingVectorEnv) -> int:
    """Return what the environment must hold: the simulator's state, and each boat's generator and trail."""
    arrays = [value for value in vars(env.simulator).values() if isinstance(value, np.ndarray)]
    return sum(array.nbytes for array in arrays)


def single_step_ms(decisions: int) -> list[float]:
    """Return the time of each step of one boat through `gymnasium.make` [ms]."""
    env = gymnasium.make("dockctl/S3-v0")
    env.reset(seed=0)
    times = []
    for action in np.random.default_rng(2).integers(env.action_space.n, size=decisions):
        begin = time.perf_counter()
        _, _, terminated, truncated, _ = env.step(action)
        times.append(1e3 * (time.perf_counter() - begin))
        if terminated or truncated:
            env.reset()
    return times[20:]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    report = bench.Report("environment", "The environment of scenario 3, full LiDAR")
    cores, envs, held = thread_count(), {}, {}
    warm = DockingVectorEnv("s3", 1, exploring=True)
    warm.reset(seed=0)
    stepping(warm, 20)()
    for boats in BOATS:
        before = resident_bytes()
        envs[boats] = DockingVectorEnv("s3", boats, exploring=True)
        envs[boats].reset(seed=0)
        stepping(envs[boats], 2)()
        held[boats] = resident_bytes() - before
    report.seconds = bench.alternate(stepping_cases(envs, cores), arguments.rounds, "by the wall")
    processor = bench.alternate(stepping_cases(envs, 1), arguments.rounds, "by the processor")
    one_boat = single_step_ms(1020)
    report.facts = {
        "boats": list(BOATS),
        "cores": cores,
        "processor_seconds": [bench.summary(seconds) for seconds in processor.values()],
        "held_bytes": [held[boats] for boats in BOATS],
        "state_bytes_a_boat": state_bytes(envs[BOATS[-1]]) / BOATS[-1],
        "held_bytes_a_boat": held[BOATS[-1]] / BOATS[-1],
        "one_step_ms": {"median": statistics.median(one_boat), "p99": float(np.percentile(one_boat, 99))},
    }
    report.bars = [
        bench.Bar(
            f"a boat's step among {more}, against among {fewer}",
            bench.ratio(processor, more, fewer),
            at_most=1.1,
            unit="×",
        )
        for fewer, more in pairwise(processor)
    ]
    report.bars += [
        bench.Bar(
            "one step through gymnasium.make, median", statistics.median(one_boat), at_most=3, unit="ms"
        ),
        bench.Bar("memory a boat, of 4,096", report.facts["held_bytes_a_boat"] / 1e3, at_most=20, unit="kB"),
    ]
    report.tell()


if __name__ == "__main__":
    main()
