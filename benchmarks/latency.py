"""Latency of the policy and of a whole decision, for one boat on one core.

    python benchmarks/latency.py

A decision consists of scan, observation, forward pass and choice of the action.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import bench  # before numpy
import numpy as np
import torch
from numpy.typing import NDArray

from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.policy import GreedyPolicy
from dockctl.agents.tensors import numpy_tensors
from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.latency import time_decisions
from dockctl.sim.lidar import spinning_sensor as lidar_module

FORWARDS = 2600
WARM_UP = 100


def microseconds(work: Callable[[], object], times: int) -> NDArray[np.float64]:
    """Return the times of single calls (times,) [us]."""
    taken = np.empty(times)
    for index in range(times):
        begin = time.perf_counter()
        work()
        taken[index] = time.perf_counter() - begin
    return 1e6 * taken


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decisions", type=int, default=2000)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    lidar_module.usable_cores = lambda: 1
    env = DockingVectorEnv("s3", 1)
    observation, _ = env.reset(seed=0)
    training = env.scenario.training
    network = DuelingQNetwork(observation.shape[1], int(env.single_action_space.n), training.hidden_sizes)
    policy = GreedyPolicy(numpy_tensors(network.state_dict()))
    report = bench.Report("latency", "Latency: one boat, one core")
    forward = microseconds(lambda: policy.act(observation, {}), FORWARDS)[WARM_UP:]
    decisions = time_decisions(env, policy, arguments.decisions)
    report.facts = {
        "decisions": len(decisions),
        "forward_us": {f"p{p}": float(np.percentile(forward, p)) for p in (50, 99)},
        "milliseconds": {
            part: {f"p{p}": float(np.percentile(decisions[part], p)) for p in (50, 99)} for part in decisions
        },
    }
    slowest = report.facts["milliseconds"]["decision_ms"]["p99"]
    report.targets = [
        bench.Target("policy, p99", report.facts["forward_us"]["p99"], at_most=150, unit="µs"),
        bench.Target("whole decision, p99", slowest, at_most=4, unit="ms"),
    ]
    report.write()


if __name__ == "__main__":
    main()
