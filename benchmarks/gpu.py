"""Updates a second of the learner on a graphics processor, against one core of the machine it sits in.

    python benchmarks/gpu.py                      # not part of `make bench`; says so where there is none

An update ends when its loss has come back to the processor, so that nothing is left waiting in a queue.
"""

from __future__ import annotations

import argparse

import bench  # before numpy
import torch
from learner import autograd, ours

from dockctl.envs.single import DockingEnv

BATCHES = (256, 512, 1024, 2048, 4096, 8192)
TRANSITIONS = 200_000
"""About as many as are learned from in one round."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("torch sees no graphics processor here")
    torch.set_num_threads(1)
    env, report = DockingEnv("s3"), bench.Report("gpu", "Learner: updates on a graphics processor")
    device, core = torch.cuda.get_device_name(), "one core"
    report.facts = {"gpu": device, "updates_per_second": {}}
    for batch in BATCHES:
        count = TRANSITIONS // batch
        learners = {device: autograd(env, batch, "cuda"), core: ours(env, batch)}
        # By the clock on the wall: a graphics processor's time is none of the processor's.
        cases = {
            name: bench.Case(lambda learn=learn, count=count: learn(count), count, cores=2)
            for name, learn in learners.items()
        }
        times = bench.alternate(cases, arguments.rounds, f"updates, batch {batch}")
        report.facts["updates_per_second"][str(batch)] = {
            name: 1 / bench.summary(values)["median"] for name, values in times.items()
        }
        report.seconds |= {f"batch {batch}: {name}": values for name, values in times.items()}
        bar = bench.Bar(
            f"batch {batch}, against one core", bench.ratio(times, core, device), at_least=1, unit="×"
        )
        report.bars.append(bar)
    report.tell()


if __name__ == "__main__":
    main()
