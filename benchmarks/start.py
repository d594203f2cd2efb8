"""Seconds from the command to the first gradient step, with warm caches and without caches.

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
    report = bench.Report("start", "From the command to the first gradient step")
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
    report.write()


if __name__ == "__main__":
    main()
