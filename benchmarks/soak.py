"""Soak test: memory and open files of one process that trains and evaluates for a long time.

    python benchmarks/soak.py --minutes 30 --evaluations 1000

Each round trains a new run of the next scenario in two halves, the second one resumed, and then evaluates
shipped policies until the evaluations keep pace with the time spent on training. Memory is compared between
whole turns through the scenarios, because a marina needs more than a single berth, and over the second half:
before, code is compiled, caches fill, and the surfaces of harbor parts are built, each when a boat first
comes near it. A leak grows in both halves.
"""

from __future__ import annotations

import argparse
import io
import itertools
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import bench
import psutil
from rich.console import Console

from dockctl.evaluation import evaluate
from dockctl.experiments import resume, train

TRAINED = ("s1", "s2", "s3", "marina")
EVALUATED = ("s1", "s2", "s3")
LARGEST_GROWTH_MB = 25

Sample = dict[str, float | str]


def train_once(scenario: str, steps: int, seed: int) -> float:
    """Train and resume a run in a temporary folder, and return the time that it took [s]."""
    begin, silent = time.monotonic(), Console(file=io.StringIO())
    with tempfile.TemporaryDirectory() as folder:
        run = train(scenario, seed=seed, steps=steps // 2, out=Path(folder), console=silent)
        resume(run.path, steps=steps, console=silent)
    return time.monotonic() - begin


def sample(began: float, scenario: str, training_s: float, steps: int, evaluations: int) -> Sample:
    """Return what the process uses now: memory [MB], open files and threads."""
    process, heap = psutil.Process(), psutil.heap_info()
    return {
        "minutes": (time.monotonic() - began) / 60,
        "trained": scenario,
        "training_minutes": training_s / 60,
        "steps": steps,
        "evaluations": evaluations,
        "rss_mb": process.memory_info().rss / 2**20,
        "allocated_mb": (heap.heap_used + heap.mmap_used) / 2**20,  # of the C heap, freed memory excluded
        "open_files": process.num_fds(),
        "threads": process.num_threads(),
    }


def soak(minutes: float, evaluations: int, steps: int) -> list[Sample]:
    """Train for `minutes` and run `evaluations`; print and return a sample after each training run."""
    began, training_s, done = time.monotonic(), 0.0, 0
    policies = itertools.cycle(EVALUATED)
    samples: list[Sample] = []
    while training_s < 60 * minutes or len(samples) % len(TRAINED):
        scenario, number = TRAINED[len(samples) % len(TRAINED)], len(samples) + 1
        training_s += train_once(scenario, steps, seed=number)
        due = min(evaluations, round(evaluations * training_s / (60 * minutes)))
        for _ in range(done, due):
            evaluate(next(policies), episodes=1, seed=number)
        done = due
        samples.append(sample(began, scenario, training_s, number * steps, done))
        if number == 1:
            print(*(f"{name:>16}" for name in samples[0]))
        texts = (f"{value:,.1f}" if isinstance(value, float) else value for value in samples[-1].values())
        print(*(f"{text:>16}" for text in texts), flush=True)
    return samples


def growth(samples: Sequence[Sample], key: str) -> float:
    """Return the largest value of the last turn through the scenarios, minus that of the middle turn."""
    size = len(TRAINED)
    largest = [max(float(one[key]) for one in samples[i : i + size]) for i in range(0, len(samples), size)]
    return largest[-1] - largest[len(largest) // 2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30, help="of training")
    parser.add_argument("--evaluations", type=int, default=1000)
    parser.add_argument("--steps", type=int, default=20_000, help="of each training")
    arguments = parser.parse_args()
    report = bench.Report("soak", "Soak")
    samples = soak(arguments.minutes, arguments.evaluations, arguments.steps)
    report.facts = {**vars(arguments), "samples": samples}
    report.targets = [
        bench.Target("growth of memory", growth(samples, "rss_mb"), at_most=LARGEST_GROWTH_MB, unit="MB"),
        bench.Target("growth of open files", growth(samples, "open_files"), at_most=0),
        bench.Target("growth of threads", growth(samples, "threads"), at_most=0),
    ]
    report.write()


if __name__ == "__main__":
    main()
