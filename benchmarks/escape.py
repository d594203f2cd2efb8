"""From which starts of a policy's collisions can the boat get into open water at all?

    python benchmarks/escape.py marinas-weather
    python benchmarks/escape.py marinas-weather --seed 777 --set harbor.held_out_seed=8000000

The test starts run as in ``dockctl evaluate``. From each that ends in contact on the way to the intermediate
pose, 4,096 copies of the boat spread over the poses that it can reach, in the weather of the episode, gusts
included, with random commands of 2 s: a copy goes on if it is the first in its cell of position, heading and
surge. A search that finds nothing does not prove that there is no way out.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import bench  # before numpy
import numpy as np
from rich.progress import track

from dockctl.evaluation import Rollout, load_policy
from dockctl.evaluation.starts import evaluation_starts, testing_starts
from dockctl.geometry import Ints
from dockctl.scenarios.schema import Scenario
from dockctl.sim.goal import TO_INTERMEDIATE
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start
from dockctl.sim.world import NothingInRange, World

BOATS, COMMANDS, HELD_S, SEARCHED_S = 4096, 32, 2.0, 200.0
"""Copies of the boat, commands that each tries, for how long it holds one, and length of the search."""
OPEN_M = 2.5
"""Clearance of a boat in open water."""
CELL = np.array([0.15, 0.15, 4.0, 0.12])
"""Size of a cell: x, y [m], heading [deg], surge [m/s]."""


def evaluated_starts(rollout: Rollout, seed: int | None = None) -> list[Start]:
    """Return the random starts of ``dockctl evaluate``, with the same weather."""
    scenario, worlds = rollout.loaded.scenario, rollout.worlds
    random = scenario.evaluation.random_starts
    before = len(evaluation_starts(scenario, worlds))  # they run first, and start i has the weather of seed i
    drawn = testing_starts(scenario, worlds, random.episodes, random.seed if seed is None else seed)
    return [replace(start, seed=before + i) for i, start in enumerate(drawn)]


def chosen(value: Any, rows: Ints) -> Any:
    """Return the rows of every array in the state of a simulator."""
    if isinstance(value, dict):
        return {name: chosen(each, rows) for name, each in value.items()}
    if isinstance(value, list):
        return [chosen(each, rows) for each in value]
    return value[rows].copy() if isinstance(value, np.ndarray) and value.shape[:1] == (BOATS,) else value


def seconds_to_open_water(scenario: Scenario, world: World, start: Start) -> float | None:
    """Return when a copy of the boat is first in open water [s], or None if none gets there."""
    blind = replace(world, lidar=NothingInRange(scenario.sensors.lidar))  # scans would take most of the time
    simulator, rng = Simulator(scenario, [blind], BOATS), np.random.default_rng(0)
    simulator.reset(np.arange(BOATS), [replace(start, harbor=0)] * BOATS)
    commands = scenario.actions.commands(
        np.arange(scenario.actions.space(scenario.vessel).n), scenario.vessel
    )
    period_s = scenario.vessel.control_period_s
    steps, known, latest = round(HELD_S / period_s), set[bytes](), np.zeros(1, np.int64)
    for layer in range(1, round(SEARCHED_S / HELD_S) + 1):
        parents = np.resize(rng.permutation(latest.repeat(COMMANDS)), BOATS)
        simulator.restore(chosen(simulator.state(), parents))
        command, touched = commands[rng.integers(len(commands), size=BOATS)], np.zeros(BOATS, bool)
        for _ in range(steps):
            touched |= simulator.step(command).collided
        clear = np.flatnonzero(~touched)
        if (world.obstacles.clearance(simulator.eta[clear]) >= OPEN_M).any():
            return layer * steps * period_s
        eta, surge = simulator.eta[clear], simulator.nu[clear, 0]
        place = np.column_stack([eta[:, :2], np.degrees(eta[:, 2]) % 360, surge])
        cells = [cell.tobytes() for cell in np.floor(place / CELL).astype(np.int16)]
        first = []
        for i, cell in enumerate(cells):
            if cell not in known:
                known.add(cell)
                first.append(i)
        if not first:
            return None
        latest = clear[first]
    return None


def main(policy: str, seed: int | None, overrides: Sequence[str]) -> None:
    """Print a line for each start from which the policy collides before the intermediate pose."""
    given = load_policy(policy)
    rollout = Rollout(given.scenario(None, tuple(overrides)))
    scenario, worlds = rollout.loaded.scenario, rollout.worlds
    starts = evaluated_starts(rollout, seed)
    episodes = rollout.run(given.make(rollout.env()), starts)
    docked = sum(episode.docked for episode in episodes)
    bench.console.print(f"docked from {docked} of {len(starts)} starts")
    early = [
        (index, start)
        for index, (start, episode) in enumerate(zip(starts, episodes, strict=True))
        if episode.outcome == "collision" and episode.phase == TO_INTERMEDIATE
    ]
    for index, start in track(early, "searching", console=bench.console, transient=True):
        world = worlds[start.harbor]
        found = seconds_to_open_water(scenario, world, start)
        way = "no way out found" if found is None else f"in open water after {found:g} s"
        clearance = float(np.asarray(world.obstacles.clearance(start.eta[None]))[0])
        bench.console.print(f"start {index}: {clearance:.3f} m clear, {way}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("policy")
    parser.add_argument("--seed", type=int)
    parser.add_argument("--set", action="append", default=[])
    options = parser.parse_args()
    main(options.policy, options.seed, options.set)
