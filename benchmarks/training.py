"""Wall time from `dockctl train` to mastery, environment steps per second, and use of the cores.

    python benchmarks/training.py                 # half an hour; not part of `make bench`
    python benchmarks/training.py --scenarios s3 --seeds 0

Scenarios 1 to 3 are mastered when their stop rule ends the training. The marina has none: it is mastered at
the first validation that docks from 99 of 100 starts. The runs are written to a temporary folder.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import bench
import pandas as pd
import psutil

from dockctl.experiments.interrupt import INTERRUPTED
from dockctl.run_files import EVALUATIONS_CSV, PROVENANCE, TIMING_CSV

POLL_S = 0.2
ENOUGH = 0.99  # of the marina's validation starts
LEARNING = (20_000, 90_000)  # environment steps between which steps per second are measured


@dataclass(frozen=True)
class Limits:
    """Largest wall times to mastery [s]: of the median seed and of each seed."""

    median_s: float
    each_s: float


LIMITS = {
    "s1": Limits(30, 60),
    "s2": Limits(30, 60),
    "s3": Limits(60, 120),
    "marina": Limits(360, 360),
}


def train(scenario: str, seed: int, out: Path) -> dict[str, Any]:
    """Train until mastery, and return the duration, the environment steps and the use of resources."""
    command = [sys.executable, "-m", "dockctl", "train", scenario, "--seed", str(seed), "--out", str(out)]
    begin = time.perf_counter()
    process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    processor_s = peak_bytes = 0.0
    started: tuple[float, float] | None = None  # wall and processor time at the first evaluation
    while process.poll() is None:
        with contextlib.suppress(psutil.Error):  # the process may have ended
            times, memory = process.cpu_times(), process.memory_info()
            processor_s, peak_bytes = times.user + times.system, max(peak_bytes, memory.rss)
            if started is None and evaluated(out):
                started = time.perf_counter(), processor_s
            last = time.perf_counter()
        if scenario == "marina" and docked_share(out) >= ENOUGH:
            break
        time.sleep(POLL_S)
    wall = time.perf_counter() - begin
    if process.poll() is None:
        process.terminate()
        process.wait()
    if process.returncode not in (0, INTERRUPTED):
        raise subprocess.CalledProcessError(process.returncode, command)
    (provenance,) = out.glob(f"*/*/{PROVENANCE}")
    stop_reason = json.loads(provenance.read_text(encoding="utf-8"))["stop_reason"]
    timing = pd.read_csv(next(out.glob(f"*/*/{TIMING_CSV}")))
    learning = timing[timing["env_steps"].between(*LEARNING)].diff().sum()
    rate = float(learning["env_steps"] / learning["wall_s"]) if learning["wall_s"] else None
    return {
        "scenario": scenario,
        "seed": seed,
        "wall_s": wall,
        "env_steps": int(timing["env_steps"].iloc[-1]),
        "validation": docked_share(out),
        "mastered": docked_share(out) >= ENOUGH if scenario == "marina" else stop_reason == "mastered",
        "cores_used": processor_s / wall,
        "cores_training": (processor_s - started[1]) / (last - started[0]) if started else None,
        "peak_memory_gb": peak_bytes / 1e9,
        "steps_per_second": rate,
    }


def evaluated(out: Path) -> bool:
    """Return whether a policy has been evaluated."""
    return any(len(path.read_bytes().splitlines()) > 1 for path in out.glob(f"*/*/{TIMING_CSV}"))


def docked_share(out: Path) -> float:
    """Return the share of its validation starts that the latest validated policy docked from, or 0."""
    found = [*out.glob(f"*/*/{EVALUATIONS_CSV}")]
    table = pd.read_csv(found[0], usecols=["env_steps", "start_kind", "outcome"]) if found else pd.DataFrame()
    if table.empty or (starts := table[table["start_kind"] != "pose"]).empty:
        return 0.0
    latest = starts[starts["env_steps"] == starts["env_steps"].max()]
    return float((latest["outcome"] == "docked").mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenarios", nargs="+", default=list(LIMITS), choices=LIMITS)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3, 4])
    arguments = parser.parse_args()
    report = bench.Report("training", "Training until mastery")
    runs = []
    for scenario, seed in bench.track([*product(arguments.scenarios, arguments.seeds)], "trainings"):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(train(scenario, seed, Path(folder)))
            bench.console.print(runs[-1])
    report.facts = {"runs": runs, "cores": os.cpu_count()}
    report.targets = [
        bench.Target("trainings that reached mastery", sum(run["mastered"] for run in runs), len(runs)),
        bench.Target("peak memory", max(run["peak_memory_gb"] for run in runs), at_most=1.5, unit="GB"),
    ]
    for scenario in arguments.scenarios:
        own = [run["wall_s"] for run in runs if run["scenario"] == scenario]
        limits = LIMITS[scenario]
        report.targets += [
            bench.Target(
                f"{scenario} to mastery, median", statistics.median(own), None, limits.median_s, "s"
            ),
            bench.Target(f"{scenario} to mastery, longest", max(own), None, limits.each_s, "s"),
        ]
    if third := [run for run in runs if run["scenario"] == "s3"]:
        cores, rate = (
            statistics.median(run[key] for run in third) for key in ("cores_training", "steps_per_second")
        )
        report.targets += [
            bench.Target("cores in use, of 2, while training s3", cores, at_least=1.85),
            bench.Target("environment steps per second while learning s3", rate, at_least=4500),
        ]
    report.write()


if __name__ == "__main__":
    main()
