"""Docking in minimum time, planned with full knowledge of harbor and weather, next to the policies.

    python benchmarks/optimal_control.py

The plan (`planning.py`) knows the harbor, the wind and the current, and its commands are continuous; those of
the policies are a grid. IPOPT is a local solver: a time is an upper bound of the minimum, and a failed search
does not prove that no plan exists.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable, Iterator
from typing import Any

import bench  # before numpy
import numpy as np
from escape import evaluated_starts
from planning import CLEARANCE_M, Docking, Optimum, Plan, followed, optimum, straight

from dockctl.evaluation import Rollout, load_policy
from dockctl.evaluation.rollout import Episode
from dockctl.evaluation.starts import testing_starts
from dockctl.geometry import Floats
from dockctl.sim.starts import given_start, own_site

CASES = (("s1", "s1"), ("s2", "s2-poses"), ("s3", "s3"), ("s3-direct", "s3-direct"))
"""Shipped policy and scenario."""
DIRECT_STARTS = 20
"""Number of random starts of the scenario without an intermediate pose."""
SPEEDS_MPS = (0.3, 0.15)
"""Average speeds of the first guesses along straight lines; a plan has at most the time of its guess."""
WEATHER = {
    "beam wind": ("wind", (90, 270), np.arange(1, 13)),
    "cross current": ("current", (90, 270), np.arange(1, 8) * 0.05),
    "current out of the berth": ("current", (180,), np.arange(1, 9) * 0.05),
}
"""Condition, directions in which it flows [deg], and speeds [m/s], each constant, from the start of s1."""
STORMS = ((5.0, 0.1), (8.0, 0.15))
"""Wind and current at once [m/s, m/s], each constant and from random directions."""
STORM_SPEEDS_MPS = (*SPEEDS_MPS, 0.08)
DRAWS = 30
VARIATION = {"wind": "gust_mps", "current": "variation_mps"}
SLACK = 1.8
"""Periods of a guess in stronger weather, relative to those needed in weaker."""
KNOWN_S = 38.7
"""Calm optimum of scenario 1 that another program found, in a corridor of 3.6 m in the berth."""


def result(docking: Docking, found: Optimum | None, episode: Episode) -> dict[str, Any]:
    """Return the row of one task: the optimum, its replay in the simulator, and the episode of a policy."""
    x, y, heading = docking.start.eta.tolist()
    row: dict[str, Any] = {
        "start": [x, y, round(math.degrees(heading), 6)],
        "policy_outcome": episode.outcome,
        "policy_s": episode.steps * docking.control_period_s,
    }
    if found:
        row |= {
            "optimum_s": found.time_s,
            "simulated_s": found.run.steps * docking.control_period_s,
            "off_m": found.run.off_m,
            "off_deg": found.run.off_deg,
            "obstacles": found.obstacles,
        }
    return row


def path(poses: Floats, control_period_s: float) -> dict[str, list[float]]:
    """Return time, position and heading of a path about every second, for the figure."""
    rows = np.unique(np.append(np.arange(0, len(poses), round(1 / control_period_s)), len(poses) - 1))
    x, y, heading = poses[rows].T
    columns = {"time_s": rows * control_period_s, "x_m": x, "y_m": y, "heading_deg": np.degrees(heading)}
    return {name: np.round(values, 3).tolist() for name, values in columns.items()}


def calm(paths: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a row for each start of the scenarios, and add the paths of scenario 3 to `paths`."""
    plans: list[Plan] = []
    for name, scenario in CASES:
        policy = load_policy(name)
        loaded = policy.scenario(scenario)
        rollout, site, task = Rollout(loaded), own_site(loaded.scenario), loaded.scenario.task
        starts = [given_start(site, task, pose, index) for index, pose in enumerate(site.initial)]
        episodes = rollout.run(policy.make(rollout.env()), starts)
        for start, episode in zip(starts, episodes, strict=True):
            docking = Docking(loaded, rollout.worlds, start)
            guesses = [straight(docking, SPEEDS_MPS[0])]
            if episode.docked:
                guesses.append(followed(docking, episode))
            if len(docking.goals) == 1:  # what docks by way of the intermediate pose also docks without it
                guesses += [plan.in_one_leg for plan in plans if (plan.states[0, :3] == start.eta).all()]
            found = fastest(docking, guesses)
            if found:
                plans.append(found.plan)
            if scenario.startswith("s3"):
                if found:
                    paths[scenario] = path(found.plan.states[:, :3], docking.control_period_s)
                paths[f"{scenario}, policy"] = path(episode.trajectory["pose"], docking.control_period_s)
            yield {"scenario": scenario, "policy": name, **result(docking, found, episode)}


def direct() -> Iterator[dict[str, Any]]:
    """Yield a row for each of some random test starts of scenario 3 without its intermediate pose."""
    policy = load_policy("s3-direct")
    loaded = policy.scenario()
    rollout, tests = Rollout(loaded), loaded.scenario.evaluation.random_starts
    starts = testing_starts(loaded.scenario, rollout.worlds, DIRECT_STARTS, tests.seed)
    for start, episode in zip(starts, rollout.run(policy.make(rollout.env()), starts), strict=True):
        docking = Docking(loaded, rollout.worlds, start)
        guesses = [straight(docking, mps) for mps in SPEEDS_MPS]
        if episode.docked:
            guesses.append(followed(docking, episode))
        yield result(docking, fastest(docking, guesses), episode)


def fastest(docking: Docking, guesses: Iterable[Plan]) -> Optimum | None:
    """Return the fastest of the plans that are found from some guesses, or None."""
    tried = [optimum(docking, guess) for guess in guesses]
    return min((one for one in tried if one), key=lambda one: one.time_s, default=None)


def weather() -> Iterator[dict[str, Any]]:
    """Yield a row for each strength and direction: scenario 1 in constant wind or current.

    The first way that is found counts. After a strength without one, stronger ones are left out.
    """
    policy = load_policy("s1")
    worlds = Rollout(policy.scenario()).worlds
    for what, (kind, directions, speeds) in WEATHER.items():
        for direction in directions:
            weaker: list[Plan] = []
            for speed in speeds.round(2).tolist():
                condition = f"conditions.{kind}={{speed_mps: {speed}, direction_deg: {direction}}}"
                loaded = policy.scenario("s1", [condition])
                site = own_site(loaded.scenario)
                start = given_start(site, loaded.scenario.task, site.initial[0], 0)
                docking, rollout = Docking(loaded, worlds, start), Rollout(loaded, worlds)
                (episode,) = rollout.run(policy.make(rollout.env()), [start], clearance=False)
                guesses = weaker + [straight(docking, mps) for mps in SPEEDS_MPS]
                tried = (optimum(docking, guess) for guess in guesses)
                found = next((one for one in tried if one), None)
                yield {
                    "what": what,
                    "direction_deg": direction,
                    "speed_mps": speed,
                    **result(docking, found, episode),
                }
                if found is None:
                    break
                periods = min(math.ceil(SLACK * found.run.steps), start.max_steps)
                weaker = [found.plan.resampled([periods])]


def storms() -> Iterator[dict[str, Any]]:
    """Yield a row for each draw: scenario 1 in constant wind and current at once, from random directions.

    The policy is the one for weather with its planner. Its commands last 1 s, those of the optimum 0.5 s.
    """
    base, policy, rng = load_policy("s1"), load_policy("marinas-weather"), np.random.default_rng(0)
    worlds = Rollout(base.scenario()).worlds
    own = ["vessel.control_period_s=1.0", "vessel.substeps=10", "evaluation.planner=true"]
    for wind, current in STORMS:
        for toward in rng.uniform(0, 360, (DRAWS, 2)).round().tolist():
            weather = [
                constant(kind, speed, direction)
                for kind, speed, direction in zip(VARIATION, (wind, current), toward, strict=True)
            ]
            loaded, given = base.scenario("s1", weather), policy.scenario("s1", [*weather, *own])
            site, task = own_site(loaded.scenario), loaded.scenario.task
            start, rollout = given_start(site, task, site.initial[0], 0), Rollout(given)
            (episode,) = rollout.run(policy.make(rollout.env()), [start], clearance=False)
            docking = Docking(loaded, worlds, start)
            tried = (optimum(docking, straight(docking, mps)) for mps in STORM_SPEEDS_MPS)
            found = next((one for one in tried if one), None)
            row = result(docking, found, episode) | {
                "policy_s": episode.steps * given.scenario.vessel.control_period_s
            }
            yield {"wind_mps": wind, "current_mps": current, "toward_deg": toward, **row}


def missed() -> Iterator[dict[str, Any]]:
    """Yield a row for each test start from which the policy for weather fails.

    Plan and policy get the mean wind and current of the failed episode, without any other condition.
    """
    policy = load_policy("marinas-weather")
    rollout = Rollout(policy.scenario())
    episodes = rollout.run(policy.make(rollout.env()), evaluated_starts(rollout), clearance=False)
    null = {name: f"conditions.{name}=null" for name in rollout.loaded.scenario.conditions}
    for episode in [episode for episode in episodes if not episode.docked]:
        flows = {kind: episode.trajectory[kind].mean(axis=0) for kind in VARIATION}
        steady = dict(null)
        for kind, (x, y) in flows.items():
            steady[kind] = constant(kind, math.hypot(x, y), math.degrees(math.atan2(y, x)) % 360)
        loaded, still = (policy.scenario(overrides=[*each.values()]) for each in (steady, null))
        docking, runs = Docking(loaded, rollout.worlds, episode.start), list[Episode]()
        for weather in (loaded, still):
            own = Rollout(weather, rollout.worlds)
            runs += own.run(policy.make(own.env()), [episode.start], clearance=False)
        guesses = [followed(docking, each) for each in runs if each.docked]
        guesses += [straight(docking, mps) for mps in STORM_SPEEDS_MPS]
        tried = (optimum(docking, guess) for guess in guesses)
        found = next((one for one in tried if one), None)
        facts = {f"{kind}_mps": flow.round(3).tolist() for kind, flow in flows.items()}
        yield {"outcome": episode.outcome, **facts, **result(docking, found, runs[0])}


def constant(kind: str, speed_mps: float, direction_deg: float) -> str:
    """Return the override that makes wind or current constant; the direction is that of the flow."""
    flow = f"speed_mps: {speed_mps}, direction_deg: {direction_deg}, {VARIATION[kind]}: 0"
    return f"conditions.{kind}={{{flow}}}"


def shown(rows: Iterator[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Print each row as soon as it is known: all of them together take minutes."""
    for row in rows:
        bench.console.print(row)
        yield row


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    report = bench.Report("optimal_control", "Docking in minimum time, planned with full knowledge")
    paths: dict[str, Any] = {}
    tables = {
        "calm": calm(paths),
        "direct": direct(),
        "weather": weather(),
        "storms": storms(),
        "missed": missed(),
    }
    rows = {name: list(shown(table)) for name, table in tables.items()}
    report.facts = {**rows, "paths": paths, "clearance_m": CLEARANCE_M}
    found = [row for table in rows.values() for row in table if "optimum_s" in row]
    first = next(row for row in found if row.get("scenario") == "s1")
    report.targets = [
        bench.Target(
            f"minimum time of scenario 1, relative to {KNOWN_S} s of another program",
            first["optimum_s"] / KNOWN_S,
            at_most=1.02,
            unit="×",
        ),
        bench.Target(
            f"last pose in the simulator, off the plan, largest of {len(found)}",
            1e3 * max(row["off_m"] for row in found),
            at_most=1,
            unit="mm",
        ),
    ]
    report.write()


if __name__ == "__main__":
    main()
