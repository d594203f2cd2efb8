"""Updates per second of the learner on a GPU, compared with one core of the same machine.

    python benchmarks/gpu.py                      # not part of `make bench`; exits where there is no GPU

An update ends when its loss is back in main memory, so that no work is left in the queue of the GPU.
"""

from __future__ import annotations

import argparse

import bench  # before numpy
import torch
from learner import ours

from dockctl.envs.single import DockingEnv

BATCHES = (256, 512, 1024, 2048, 4096, 8192)
TRANSITIONS = 200_000
"""Approximate number of transitions per round."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("torch finds no GPU")
    torch.set_num_threads(1)
    env, report = DockingEnv("s3"), bench.Report("gpu", "Learner: updates on a GPU")
    device, core = torch.cuda.get_device_name(), "one core"
    report.facts = {"gpu": device, "updates_per_second": {}}
    for batch in BATCHES:
        count = TRANSITIONS // batch
        learners = {device: ours(env, batch, "cuda"), core: ours(env, batch)}
        # Wall-clock time: the time of a GPU is not part of the process's CPU time.
        cases = {
            name: bench.Case(lambda learn=learn, count=count: learn(count), count, cores=2)
            for name, learn in learners.items()
        }
        times = bench.alternate(cases, arguments.rounds, f"updates, batch {batch}")
        report.facts["updates_per_second"][str(batch)] = {
            name: 1 / bench.summary(values)["median"] for name, values in times.items()
        }
        report.seconds |= {f"batch {batch}: {name}": values for name, values in times.items()}
        target = bench.Target(
            f"batch {batch}, relative to one core", bench.ratio(times, core, device), at_least=1, unit="×"
        )
        report.targets.append(target)
    report.write()


if __name__ == "__main__":
    main()
