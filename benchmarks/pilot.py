"""Decisions of `dockctl.pilot` from full scans, against those of the policy in the simulator, and their time.

    python benchmarks/pilot.py                         # 12,000 decisions from 1,200 scans; some minutes
    python benchmarks/pilot.py --decisions 200 s1      # fewer, of one checkpoint

Each checkpoint is exported and docks in the simulator from random starts, as in `dockctl evaluate`. At every
step the pilot gets the pose, the velocity, and all points of a scan: it computes sectors, observation and
action itself. The simulator computes the sectors without the points.

Each scan is used for ten decisions: that of the episode, and nine at random velocities of the boat, the air
and the water with the command of the decision before, for which the simulator's observation is computed with
these. The errors of the sensors are left out: in the simulator, the true pose decides whether one is reached.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from dockctl.envs.observation import ObservationEncoder, View
from dockctl.evaluation import Rollout, load_policy
from dockctl.evaluation.starts import testing_starts
from dockctl.experiments.portable import export_files
from dockctl.pilot import Checks, Decision, Pilot, Reading

CHECKPOINTS = ("s1", "s2", "s3", "marina", "marinas", "marinas-weather")
"""The last two are ensembles, and the last one observes wind, current and earlier steps."""
ERRORS = ("lidar_noise", "navigation")
PER_SCAN = 10
"""Decisions from one scan: that of the episode, and others at random velocities."""
FASTEST = np.array([0.8, 0.2, 0.08])
FASTEST_AIR = np.array([8.0, 8.0])
SLOWEST_SURGE = 0.11  # [m/s]: no pose counts as reached

Row = tuple[int, np.ndarray, Decision, float]


def decisions(name: str, count: int, folder: Path) -> Iterator[Row]:
    """Yield action and observation in the simulator, the pilot's decision, and its time [ms]."""
    file = folder / f"{name}.npz"
    export_files([Path(name)], None, file)
    pilot = Pilot.load(file, checks=Checks(max_jump_m=0.1))
    loaded = load_policy(name)
    given = loaded.scenario()
    exact = {kind: each for kind, each in given.scenario.conditions.items() if kind not in ERRORS}
    env = Rollout(replace(given, scenario=given.scenario.model_copy(update={"conditions": exact}))).env()
    simulator, scenario, policy = env.simulator, env.scenario, loaded.make(env)
    encode = ObservationEncoder(scenario.observation, scenario.sensors.lidar.sectors)
    rng = np.random.default_rng(0)
    starts = testing_starts(scenario, env.worlds, 1 + count // 50, seed=0)

    def timed(pilot: Pilot, view: View) -> tuple[Decision, float]:
        now_s = step * pilot.control_period_s
        begin = perf_counter()
        pose, nu, points, *flows = (
            Reading(now_s, value)
            for value in (view.eta[0], view.nu[0], cloud, *(getattr(view, name)[0] for name in pilot.flows))
        )
        decision = pilot.decide(
            now_s, pose, nu, {"all": points}, **dict(zip(pilot.flows, flows, strict=True))
        )
        return decision, 1000 * (perf_counter() - begin)

    for number in itertools.count():
        start = starts[number % len(starts)]
        observation, info = env.reset(seed=0, options={"starts": [replace(start, seed=number)]})
        policy.reset(np.array([0]), info)
        pilot.goals = np.array(simulator.goals[0])
        if start.phase:
            pilot.goals[0] = np.nan
        pilot.reset()
        ended, step = False, 0
        while not ended:
            action = policy.act(observation, info)
            cloud = env.worlds[int(simulator.harbor[0])].lidar.points(simulator.eta[0])
            view = View.of(simulator, simulator.sector_ranges_m)
            yield int(action[0]), observation[0], *timed(pilot, view)
            other = Pilot(pilot.description, pilot.networks, pilot.goals)
            other.phase = int(simulator.phase[0])
            command, past = np.zeros((1, 2)), ()
            for _ in range(PER_SCAN - 1):
                velocity, air, water = (
                    rng.uniform(-limit, limit)[None] for limit in (FASTEST, FASTEST_AIR, FASTEST[:2])
                )
                velocity[0, 0] += math.copysign(SLOWEST_SURGE, velocity[0, 0])
                view = replace(
                    view, nu=velocity, command=command, past=past, apparent_wind=air, through_water=water
                )
                seen = encode(view)
                decision, milliseconds = timed(other, view)
                yield int(policy.act(seen, info)[0]), seen[0], decision, milliseconds
                command, past = np.array([[decision.propeller_n, decision.rudder_rad]]), (view, *past)
            observation, _, terminated, truncated, info = env.step(action)
            ended, step = bool(terminated[0] or truncated[0]), step + 1


def compare(name: str, count: int) -> dict[str, Any]:
    """Return how many of `count` decisions, observations and stops differ, and the times of the decisions."""
    with tempfile.TemporaryDirectory() as folder:
        rows = list(itertools.islice(decisions(name, count, Path(folder)), count))
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
    parser.add_argument("checkpoints", nargs="*", default=list(CHECKPOINTS))
    parser.add_argument("--decisions", type=int, default=12_000)
    given = parser.parse_args()
    results = {}
    for name in given.checkpoints:
        results[name] = compare(name, round(given.decisions / len(given.checkpoints)))
        print(name, json.dumps(results[name]), flush=True)
    print("all:", sum(result["decisions"] for result in results.values()), "decisions,", end=" ")
    print(sum(result["other_action"] for result in results.values()), "other actions")


if __name__ == "__main__":
    main()
