"""The environment with 1 to 4,096 boats: steps per second, memory, and one step through Gymnasium.

    python benchmarks/environment.py

Actions are random and starts are those of training, so that all parts of the marina are visited. Full LiDAR.
The serial part of a step is what remains without a LiDAR: scans run on all cores, everything else on one.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import bench  # before numpy
import gymnasium
import numpy as np

import dockctl.envs  # noqa: F401  registers the environments
from dockctl.compute import usable_cores
from dockctl.envs.vector import DockingVectorEnv
from dockctl.sim.world import NothingInRange

BOATS = (1, 16, 256, 4096)
BOAT_STEPS = 4096  # summed over all boats, in one round


def stepping(env: DockingVectorEnv, steps: int) -> Callable[[], None]:
    """Return a function that steps all boats `steps` times, with actions drawn beforehand."""
    actions = np.random.default_rng(1).integers(env.single_action_space.n, size=(steps, env.num_envs))

    def work() -> None:
        for action in actions:
            env.step(action)

    return work


def stepping_cases(envs: dict[int, DockingVectorEnv], cores: int) -> dict[str, bench.Case]:
    """Return the case of one step of one boat for each environment; `cores` selects the clock."""
    cases = {}
    for boats, env in envs.items():
        steps = BOAT_STEPS // boats
        cases["one boat" if boats == 1 else f"{boats:,} boats"] = bench.Case(
            stepping(env, steps), steps * boats, cores
        )
    return cases


def without_lidar(env: DockingVectorEnv) -> DockingVectorEnv:
    """Return the same environment without scans."""
    nothing = NothingInRange(env.scenario.sensors.lidar)
    worlds = [replace(world, lidar=nothing) for world in env.worlds]
    blind = DockingVectorEnv(env.scenario, env.num_envs, exploring=True, worlds=worlds)
    blind.reset(seed=0)
    return blind


def held_bytes(boats: int) -> int:
    """Return the memory of an environment with `boats` boats, without harbor and tables."""
    gc.collect()
    tracemalloc.start()
    env = DockingVectorEnv("s3", boats, exploring=True)
    env.reset(seed=0)
    stepping(env, 2)()
    gc.collect()
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return held


def state_bytes(env: DockingVectorEnv) -> int:
    """Return the memory of the state of the simulator."""
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
    cores, envs, held = usable_cores(), {}, {}
    warm = DockingVectorEnv("s3", 1, exploring=True)
    warm.reset(seed=0)
    stepping(warm, 20)()
    for boats in BOATS:
        held[boats] = held_bytes(boats)
        envs[boats] = DockingVectorEnv("s3", boats, exploring=True)
        envs[boats].reset(seed=0)
    few, some, many = BOATS[1:]
    slope = (held[some] - held[few]) / (some - few)
    report.seconds = bench.alternate(stepping_cases(envs, cores), arguments.rounds, "wall clock")
    processor = bench.alternate(stepping_cases(envs, 1), arguments.rounds, "CPU time")
    blind = {boats: without_lidar(env) for boats, env in envs.items()}
    serial = bench.alternate(stepping_cases(blind, 1), arguments.rounds, "without LiDAR")
    one_boat = single_step_ms(1020)
    report.facts = {
        "boats": list(BOATS),
        "cores": cores,
        "processor_seconds": [bench.summary(seconds) for seconds in processor.values()],
        "serial_seconds": [bench.summary(seconds) for seconds in serial.values()],
        "held_bytes": [held[boats] for boats in BOATS],
        "state_bytes_a_boat": state_bytes(envs[BOATS[-1]]) / BOATS[-1],
        "held_bytes_a_boat": slope,
        "one_step_ms": {"median": statistics.median(one_boat), "p99": float(np.percentile(one_boat, 99))},
    }
    report.targets = [
        bench.Target(
            f"time per boat and step: {more}, relative to {fewer}",
            bench.ratio(processor, more, fewer),
            at_most=1.1,
            unit="×",
        )
        for fewer, more in pairwise(processor)
    ]
    report.targets += [
        bench.Target(
            "one step through gymnasium.make, median", statistics.median(one_boat), at_most=3, unit="ms"
        ),
        bench.Target(
            f"memory of {many:,} boats, relative to a line through {few} and {some}",
            held[many] / (held[few] + slope * (many - few)),
            at_most=1.1,
            unit="×",
        ),
    ]
    report.write()


if __name__ == "__main__":
    main()
