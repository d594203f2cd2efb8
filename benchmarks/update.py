"""Training with the compiled update and with that of torch: wall time of the first 60,000 steps, alternating.

    python benchmarks/update.py                   # ten minutes; not part of `make bench`

The compiled update is kept as long as it makes training at least 1.3 times as fast from end to end.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time

import bench

SCENARIOS = ("s3", "marina")
LEAST_RATIO = 1.3
IN_TORCH = """
from dockctl.agents.dqn import update
update.CompiledSteps = update.AutogradSteps
"""
"""What a process runs before `dockctl train` so that the CPU also uses the torch update."""
COMMAND = "from dockctl.cli import main; main()"


def train(scenario: str, steps: int, before: str) -> None:
    """Train in a separate process, start-up included, and without validations."""
    with tempfile.TemporaryDirectory() as out:
        options = ["--steps", str(steps), "--out", out, "--set", f"training.evaluate_every_steps={steps}"]
        command = [sys.executable, "-c", before + COMMAND, "train", scenario, *options]
        subprocess.run(command, check=True, capture_output=True)


def seconds(scenario: str, steps: int, before: str) -> float:
    """Return the wall-clock time of a training run [s]."""
    begin = time.perf_counter()
    train(scenario, steps, before)
    return time.perf_counter() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=60_000)
    arguments = parser.parse_args()
    report = bench.Report("update", "Compiled update against that of torch")
    report.facts = vars(arguments)
    for scenario in SCENARIOS:
        names = {f"{scenario}, torch": IN_TORCH, f"{scenario}, compiled": ""}
        report.seconds |= {name: [] for name in names}
        train(scenario, arguments.steps // 10, "")  # compiles the code and builds the tables
        for _ in bench.track(range(arguments.rounds), scenario, console=bench.console, transient=True):
            for name, before in names.items():
                report.seconds[name].append(seconds(scenario, arguments.steps, before))
        ratio = bench.ratio(report.seconds, *names)
        report.targets.append(bench.Target(f"{scenario}, torch relative to compiled", ratio, LEAST_RATIO))
    report.write()


if __name__ == "__main__":
    main()
