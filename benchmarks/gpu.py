"""Simulation and learner on a GPU, compared with the CPU of the same machine.

    python benchmarks/gpu.py                      # not part of `make bench`; exits where there is no GPU

Scans from free poses in the marina of scenario 3, with and without noise, are compared with those of the CPU
bit by bit. Environment steps have random actions and the starts of training, as in `environment.py`. An
update ends when its loss is back in main memory, so that no work is left in the queue of the GPU.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import bench  # before numpy
import numpy as np
import torch
from environment import stepping
from learner import ours

from dockctl.envs.single import DockingEnv
from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import Floats
from dockctl.scenarios.extensions import RangeNoise
from dockctl.scenarios.loader import load
from dockctl.sim.devices import CPU, GPU, vessel_model
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from dockctl.sim.world import build_worlds

BATCHES = (256, 512, 1024, 2048, 4096, 8192)
TRANSITIONS = 100_000
"""Approximate number of transitions per round."""
BOATS = (256, 1024, 4096)
BOAT_STEPS = 16384
"""Steps of all boats together, per round."""
POSES = 2048
WEATHER = ("harbor.layouts=8", "harbor.held_out_layouts=1", "training.retried_starts=null")
STEPS, UPDATES = "environment steps per second", "updates per second"


def scans(poses: Floats, sensor: SpinningSensor, report: bench.Report) -> None:
    """Compare scans on the GPU with those on the CPU."""
    noise = RangeNoise(
        seeds=np.arange(len(poses), dtype=np.uint64),
        sigma_m=np.full(len(poses), 0.03),
        lost_returns=np.full(len(poses), 0.05),
        lost_sectors=np.zeros(len(poses)),
    )
    scanners: dict[str, Callable[[SpinningSensor], Floats]] = {
        "scans": lambda sensor: sensor.sector_ranges(poses),
        "noisy scans": lambda sensor: sensor.noisy_sector_ranges(poses, noise),
    }
    for what, scan in scanners.items():
        cases = {
            f"{what}, {device}": bench.Case(lambda scan=scan, on=on: scan(on), len(poses), cores=2)
            for device, on in ((CPU, sensor), (GPU, sensor.on_gpu))
        }
        report.seconds |= bench.alternate(cases, 5, what)
        difference = np.abs(scan(sensor) - scan(sensor.on_gpu))
        report.facts[what] = {"ranges": difference.size, "equal": int((difference == 0).sum())}
        target = bench.Target(
            f"{what}: largest difference", float(difference.max()) * 1e3, at_most=1, unit="mm"
        )
        report.targets.append(target)


def motion(report: bench.Report) -> None:
    """Compare the equations of motion."""
    vessel, rng = load("s3").scenario.vessel, np.random.default_rng(1)
    eta, nu = rng.normal(size=(POSES, 3)), rng.normal(scale=0.3, size=(POSES, 3))
    command = rng.uniform(-1, 1, (POSES, 2)) * vessel.command_limit
    one, other = (vessel_model(vessel, device).step(eta, nu, command)[0] for device in (CPU, GPU))
    target = bench.Target(
        "positions after one step: largest difference",
        float(np.abs(one - other)[:, :2].max()) * 1e3,
        at_most=1,
        unit="mm",
    )
    report.targets.append(target)


def steps(report: bench.Report, rounds: int) -> None:
    """Time environment steps, in scenario 3 and in the weather of 8 generated marinas."""
    weather = load("marinas-weather", overrides=WEATHER)
    scenarios = {"s3": load("s3"), "marinas-weather": weather}
    rates = report.facts[STEPS] = {}
    for name, loaded in scenarios.items():
        worlds = build_worlds(loaded.scenario, loaded.base_dir)
        for boats in BOATS if name == "s3" else (4096,):
            cases = {}
            for device in (CPU, GPU):
                env = DockingVectorEnv(loaded, boats, exploring=True, worlds=worlds, device=device)
                env.reset(seed=0)
                count = max(1, BOAT_STEPS // boats)
                cases[device] = bench.Case(stepping(env, count), count * boats, cores=2)
            what = f"{name}, {boats:,} boats"
            times = bench.alternate(cases, rounds, what)
            rates[what] = {device: 1 / bench.summary(own)["median"] for device, own in times.items()}
            report.seconds |= {f"{what}, {device}": own for device, own in times.items()}
    best = max(own[GPU] for what, own in rates.items() if what.startswith("s3"))
    report.targets.append(bench.Target(f"s3: {STEPS} on the GPU", best, at_least=50_000))


def updates(report: bench.Report, rounds: int) -> None:
    """Time updates of the learner, compared with one core."""
    env = DockingEnv("s3")
    rates = report.facts[UPDATES] = {}
    for batch in BATCHES:
        count = TRANSITIONS // batch
        learners = {device: ours(env, batch, device) for device in (CPU, GPU)}
        # Wall-clock time: the time of a GPU is not part of the process's CPU time.
        cases = {
            device: bench.Case(lambda learn=learn, count=count: learn(count), count, cores=2)
            for device, learn in learners.items()
        }
        times = bench.alternate(cases, rounds, f"updates, batch {batch}")
        rates[str(batch)] = {device: 1 / bench.summary(own)["median"] for device, own in times.items()}
        report.seconds |= {f"batch {batch}, {device}": own for device, own in times.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("torch finds no GPU")
    torch.set_num_threads(1)
    report = bench.Report("gpu", "Simulation and learner on a GPU")
    report.facts["gpu"] = torch.cuda.get_device_name()
    marina = build_worlds(load("s3").scenario, load("s3").base_dir)[0]
    poses = np.random.default_rng(0).uniform((0, -25, -np.pi), (60, 25, np.pi), (2 * POSES, 3))
    poses = poses[~marina.obstacles.near(poses, 0.05)][:POSES]
    assert isinstance(marina.lidar, SpinningSensor)
    scans(poses, marina.lidar, report)
    motion(report)
    steps(report, arguments.rounds)
    report.write()  # the updates take minutes
    updates(report, arguments.rounds)
    report.write()


if __name__ == "__main__":
    main()
