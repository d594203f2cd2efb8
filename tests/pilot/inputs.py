"""Good inputs of a pilot."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from dockctl.pilot import Decision, Pilot, Reading

INTERMEDIATE, FINAL = (18.0, 3.0, math.radians(150)), (36.0, 0.0, math.pi)
AWAY, REST = (23.0, -10.0, math.pi / 2), (0.0, 0.0, 0.0)
CLOUD = np.array([[8.0, 1.0, 0.5], [-4.0, -3.0, 1.0], [0.5, 6.0, 0.2]])


def decide(pilot: Pilot, now_s: float = 0.0, **readings: Any) -> Decision:
    """Decide from good inputs measured now, except those given."""
    good = {"pose": AWAY, "velocity": REST, "cloud": CLOUD}
    given = {name: Reading(now_s, value) for name, value in good.items()}
    given |= {
        name: value if value is None or isinstance(value, Reading) else Reading(now_s, value)
        for name, value in readings.items()
    }
    return pilot.decide(now_s, given["pose"], given["velocity"], {"bow": given["cloud"]})


def in_wind(pilot: Pilot, now_s: float, **readings: Any) -> Decision:
    """Decide from good inputs measured now, except those given."""
    good = {"pose": AWAY, "velocity": REST, "apparent_wind": (-3.0, 1.0), "through_water": (0.3, -0.05)}
    given = {name: Reading(now_s, value) for name, value in good.items()} | readings
    return pilot.decide(now_s, clouds={"bow": Reading(now_s, CLOUD)}, **given)


def observed(pilot: Pilot, decision: Decision) -> dict[str, float]:
    """Return the columns of an observation in units."""
    assert decision.observation is not None
    columns = zip(pilot.description["observation"], decision.observation, strict=True)
    return {column["name"]: column["scale"] * value for column, value in columns}
