"""Training of scenario 3 until its stop rule holds: wall time and use of the cores, median of three seeds.

    python benchmarks/training.py                 # minutes per seed; not part of `make bench`
    python benchmarks/training.py --seeds 0

The runs are written to a temporary folder.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import bench


def train(seed: int, out: Path) -> dict[str, float | str]:
    """Train scenario 3 once, and return its duration and use of resources."""
    begin = time.perf_counter()
    command = [sys.executable, "-m", "dockctl", "train", "s3", "--seed", str(seed), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, process.returncode, used = os.wait4(process.pid, 0)
    wall = time.perf_counter() - begin
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    (provenance,) = out.glob(f"s3/*-seed{seed}/provenance.json")
    facts = json.loads(provenance.read_text(encoding="utf-8"))
    return {
        "seed": seed,
        "wall_s": wall,
        "cores_used": (used.ru_utime + used.ru_stime) / wall,
        "peak_memory_gb": 1024 * used.ru_maxrss / 1e9,
        "stop_reason": facts["stop_reason"],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    arguments = parser.parse_args()
    report = bench.Report(
        "training", "Scenario 3 to mastery: 95 of 100 training episodes, and every test pose"
    )
    with tempfile.TemporaryDirectory() as folder:
        runs = [train(seed, Path(folder)) for seed in bench.track(arguments.seeds, "seeds")]
    report.facts = {"runs": runs, "cores": os.cpu_count()}

    def median(key: str) -> float:
        return statistics.median(float(run[key]) for run in runs)

    report.targets = [
        bench.Target("wall time", median("wall_s") / 60, at_most=5, unit="min"),
        bench.Target("cores in use, of 2", median("cores_used"), at_least=1.4),
        bench.Target("peak memory", median("peak_memory_gb"), at_most=1.5, unit="GB"),
        bench.Target(
            "runs that stopped after mastery",
            sum(run["stop_reason"] == "mastered" for run in runs),
            len(runs),
        ),
    ]
    report.write()


if __name__ == "__main__":
    main()
