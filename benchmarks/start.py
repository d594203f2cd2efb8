"""Seconds from the command to the first gradient step, with and without caches, and of short commands.

    python benchmarks/start.py

The process is stopped when the first row of ``updates.csv`` is written.
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

from dockctl.run_files import UPDATES_CSV
from dockctl.scenarios.loader import load

WARM_S = {"s3": 3, "marina": 8}
"""Largest time to the first gradient step with cached tables and code [s], by scenario."""

SHORT_S = {"evaluate --ckpt s3 --episodes 0": 2.5, "validate s3": 0.5}
"""Largest duration with cached tables and code [s], by command; the first runs the test episode."""


def duration(command: str) -> float:
    """Return the duration of a command of dockctl [s]."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-m", "dockctl", *command.split()], check=True, capture_output=True)
    return time.perf_counter() - begin


def seconds_to_first_update(scenario: str, caches: Path) -> float:
    """Return the time until the first gradient step, with these caches of tables and compiled code [s]."""
    training = load(scenario).scenario.training
    few = training.warmup_steps + 20 * training.steps_per_update  # few, so that every update has its own row
    environment = {**os.environ, "XDG_CACHE_HOME": str(caches), "NUMBA_CACHE_DIR": str(caches / "numba")}
    with tempfile.TemporaryDirectory() as out:
        steps = ["--set", f"training.total_steps={few}"]
        command = [sys.executable, "-m", "dockctl", "train", scenario, "--out", out, *steps]
        begin = time.perf_counter()
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment
        )
        while not any(table.stat().st_size for table in Path(out).glob(f"*/*/{UPDATES_CSV}")):
            if process.poll() is not None:
                raise RuntimeError(f"{scenario}: the training ended before its first gradient step")
            time.sleep(0.01)
        taken = time.perf_counter() - begin
        process.terminate()
        process.wait()
    return taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    report = bench.Report("start", "Start of trainings, and short commands")
    for scenario in bench.track(WARM_S, "starts", console=bench.console, transient=True):
        first, warm = [], []
        for _ in range(arguments.rounds):
            with tempfile.TemporaryDirectory() as caches:
                first.append(seconds_to_first_update(scenario, Path(caches)))
                warm.append(seconds_to_first_update(scenario, Path(caches)))
        report.seconds |= {f"{scenario}, first start": first, f"{scenario}, cached": warm}
        more = statistics.median(a - b for a, b in zip(first, warm, strict=True))
        report.targets += [
            bench.Target(f"{scenario}, cached", statistics.median(warm), at_most=WARM_S[scenario], unit="s"),
            bench.Target(f"{scenario}, first start: tables and compilation", more, at_most=25, unit="s"),
        ]
    for command, limit in SHORT_S.items():
        duration(command)  # fills the caches
        times = [duration(command) for _ in range(arguments.rounds)]
        report.seconds[f"dockctl {command}"] = times
        report.targets.append(
            bench.Target(f"dockctl {command}", statistics.median(times), at_most=limit, unit="s")
        )
    report.write()


if __name__ == "__main__":
    main()
