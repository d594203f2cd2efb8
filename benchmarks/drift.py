"""How often does a policy dock, by the drift of the boat across its berth?

    dockctl evaluate marinas-weather --json a.json
    python benchmarks/drift.py a.json

The drift is the steady sway over ground of a boat that has the heading of the berth and no thrust, in the
mean wind and current of its episode: that of the current, and that at which the damping balances the wind.
"""

from __future__ import annotations

import argparse
import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from dockctl.scenarios.loader import load
from dockctl.sim.conditions.authority import ControlAuthority
from dockctl.sim.conditions.wind import Wind, wind_force

AXIS_DEG = {"east": 180, "west": 0, "north": -90, "south": 90}
"""Heading of a boat in a berth, by the quay in the berth's name."""
LIMITS_MPS = (0.0, 0.03, 0.06, 0.08, 0.1, math.inf)
ITERATIONS = 50


def drift_mps(row: dict[str, Any], wind: Wind, authority: ControlAuthority) -> float:
    """Return the drift across the berth in the episode of a row of ``dockctl evaluate --json``."""
    heading = next(AXIS_DEG[word] for word in row["berth"].split() if word in AXIS_DEG)
    flows = {}
    for kind in ("current", "wind"):
        angle = math.radians(row[f"{kind}_direction_deg"] - heading)
        flows[kind] = row[f"{kind}_speed_mps"] * np.array([math.cos(angle), math.sin(angle)])
    along, across = flows["wind"] - flows["current"]
    sway = 0.0  # through the water
    for _ in range(ITERATIONS):
        push = float(wind_force(wind, np.array([along]), np.array([across - sway]))[0, 1])
        sway += (math.copysign(authority.drift(abs(push)), push) - sway) / 2
    return abs(float(flows["current"][1]) + sway)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="+", type=Path, help="files of dockctl evaluate --json")
    files = parser.parse_args().files
    scenario = load("marinas-weather").scenario
    wind = next(
        each.fitted(scenario.vessel) for each in scenario.conditions.values() if isinstance(each, Wind)
    )
    rows = [row for file in files for row in json.loads(file.read_text())["episodes"]]
    rows = [row for row in rows if row["start_kind"] == "held_out"]
    authority = ControlAuthority.of(scenario.vessel)
    drifts = np.array([drift_mps(row, wind, authority) for row in rows])
    docked = np.array([row["outcome"] == "docked" for row in rows])
    for low, high in pairwise(LIMITS_MPS):
        among = (drifts >= low) & (drifts < high)
        print(f"{low:g} to {high:g} m/s: {docked[among].sum():,} of {among.sum():,} docked")


if __name__ == "__main__":
    main()
