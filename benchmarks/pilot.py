"""Decisions of `dockctl.pilot` from full scans, against those of the policy in the simulator, and their time.

    python benchmarks/pilot.py                         # 10,000 decisions; about half an hour on one core
    python benchmarks/pilot.py --decisions 200 s1      # fewer, of one checkpoint

Each checkpoint is exported and docks in the simulator from random starts, as in `dockctl evaluate`. At every
step the pilot gets the pose, the velocity, and all points of a scan: it computes sectors, observation and
action itself. The simulator computes the sectors without the points.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from rich.progress import track

from dockctl.evaluation import Rollout, load_policy
from dockctl.evaluation.starts import testing_starts
from dockctl.experiments.portable import export_files
from dockctl.pilot import Checks, Decision, Pilot, Reading

SHARES = {"s1": 0.2, "s2": 0.2, "s3": 0.4, "marina": 0.2}


def decisions(name: str, count: int, folder: Path) -> Iterator[tuple[int, np.ndarray, Decision, float]]:
    """Yield action and observation in the simulator, the pilot's decision, and its time [ms]."""
    file = folder / f"{name}.npz"
    export_files([Path(name)], None, file)
    pilot = Pilot.load(file, checks=Checks(max_jump_m=0.1))
    loaded = load_policy(name)
    rollout = Rollout(loaded.scenario())
    env = rollout.env()
    policy = loaded.make(env)
    starts = testing_starts(env.scenario, env.worlds, 1 + count // 50, seed=0)
    made, number = 0, 0
    while made < count:
        start = starts[number % len(starts)]
        number += 1
        observation, info = env.reset(seed=0, options={"starts": [replace(start, seed=number)]})
        policy.reset(np.array([0]), info)
        pilot.goals = np.array(env.simulator.goals[0])
        if start.phase:
            pilot.goals[0] = np.nan
        pilot.reset()
        ended, step = False, 0
        while not ended and made < count:
            action = policy.act(observation, info)
            pose, velocity = info["pose"][0], info["velocity"][0]
            cloud = env.worlds[int(env.simulator.harbor[0])].lidar.points(pose)
            now = step * pilot.control_period_s
            begin = perf_counter()
            decision = pilot.decide(
                now, Reading(now, pose), Reading(now, velocity), {"all": Reading(now, cloud)}
            )
            yield int(action[0]), observation[0], decision, 1000 * (perf_counter() - begin)
            observation, _, terminated, truncated, info = env.step(action)
            ended, step, made = bool(terminated[0] or truncated[0]), step + 1, made + 1


def compare(name: str, count: int) -> dict[str, Any]:
    """Return how many of `count` decisions, observations and stops differ, and the times of the decisions."""
    with tempfile.TemporaryDirectory() as folder:
        rows = list(track(decisions(name, count, Path(folder)), name, count))
    return {
        "decisions": len(rows),
        "other_action": sum(decision.action != action for action, _, decision, _ in rows),
        "other_observation": sum(
            decision.observation is None or bool((decision.observation != observation).any())
            for _, observation, decision, _ in rows
        ),
        "stops": sorted({decision.stop for _, _, decision, _ in rows if decision.stop}),
        "milliseconds": {
            key: float(np.quantile([ms for *_, ms in rows], q)) for key, q in (("p50", 0.5), ("p99", 0.99))
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("checkpoints", nargs="*", default=list(SHARES))
    parser.add_argument("--decisions", type=int, default=10_000)
    given = parser.parse_args()
    total = sum(SHARES.get(name, 0.2) for name in given.checkpoints)
    results = {}
    for name in given.checkpoints:
        results[name] = compare(name, round(given.decisions * SHARES.get(name, 0.2) / total))
        print(name, json.dumps(results[name]), flush=True)
    print("all:", sum(result["decisions"] for result in results.values()), "decisions,", end=" ")
    print(sum(result["other_action"] for result in results.values()), "other actions")


if __name__ == "__main__":
    main()
