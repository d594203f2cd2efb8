"""From the command to the first gradient step, with all caches warm and with none.

    python benchmarks/start.py

Each case is a whole process of `dockctl train` that ends after its first update, so that the time also holds
what comes after: a greedy evaluation and a checkpoint.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench

from dockctl.scenarios.loader import load

SCENARIOS = ("s3", "marina")


def seconds_to_first_update(scenario: str, caches: Path) -> float:
    """Train until the first gradient step, with these caches of tables and compiled code [s]."""
    training = load(scenario).scenario.training
    steps = training.warmup_steps + training.boats + training.steps_per_update
    settings = {
        "training.total_steps": steps,
        "training.evaluate_every_steps": steps,
        "evaluation.random_starts.episodes": 0,
        "evaluation.trained_berths": 1,
    }
    sets = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    environment = {**os.environ, "XDG_CACHE_HOME": str(caches), "NUMBA_CACHE_DIR": str(caches / "numba")}
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "dockctl", "train", scenario, "--out", out, *sets]
        begin = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=environment)
        taken = time.perf_counter() - begin
        (updates,) = Path(out).glob("*/*/updates.csv")
        if len(updates.read_text(encoding="utf-8").splitlines()) < 2:
            raise RuntimeError(f"{scenario}: no gradient step in {steps} steps")
    return taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    report = bench.Report("start", "From the command to the first gradient step")
    for scenario in bench.track(SCENARIOS, "starts", console=bench.console, transient=True):
        first, warm = [], []
        for _ in range(arguments.rounds):
            with tempfile.TemporaryDirectory() as caches:
                first.append(seconds_to_first_update(scenario, Path(caches)))
                warm.append(seconds_to_first_update(scenario, Path(caches)))
        report.seconds |= {f"{scenario}, from nothing": first, f"{scenario}, caches warm": warm}
        more = statistics.median(a - b for a, b in zip(first, warm, strict=True))
        report.bars += [
            bench.Bar(f"{scenario}, caches warm", statistics.median(warm), at_most=8, unit="s"),
            bench.Bar(f"{scenario}, the first time, for tables and compiling", more, at_most=25, unit="s"),
        ]
    report.tell()


if __name__ == "__main__":
    main()
