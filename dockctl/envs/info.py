"""Contents of the environments' `info`; the table is in docs/gymnasium.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dockctl.geometry import Bools, Floats
from dockctl.sim.goal import StepStatus
from dockctl.sim.simulator import Simulator

Info = dict[str, Any]


def of_boats(simulator: Simulator) -> Info:
    """Return copies of the state of every boat."""
    return {
        "pose": simulator.eta.copy(),
        "velocity": simulator.nu.copy(),
        "command": simulator.command.copy(),
        "distance_m": simulator.distance_m.copy(),
        "heading_error_rad": simulator.heading_error_rad.copy(),
        "goal": simulator.goal.copy(),
        "phase": simulator.phase.copy(),
        "sector_ranges_m": simulator.sector_ranges_m.copy(),
    }


def of_conditions(simulator: Simulator) -> Info:
    """Return what the conditions of the scenario add."""
    info: Info = {}
    if simulator.disturbances.define("water_velocity"):
        info["current"] = simulator.current()
    if simulator.disturbances.define("air_velocity"):
        info["wind"] = simulator.wind()
    if simulator.disturbances.define("actuate"):
        info["actuation"] = simulator.actuation.copy()
    if simulator.disturbances.define("pose_error") or simulator.disturbances.define("velocity_error"):
        info["measured_pose"] = simulator.measured_pose()
        info["measured_velocity"] = simulator.measured_velocity()
    if episode := simulator.disturbances.episode():
        info["conditions"] = episode
    return info


def no_events(boats: int, terms: Sequence[str]) -> Info:
    """Return the events of a step in which nothing happened, with the reward terms named `terms`."""
    nothing = np.full(boats, "", object)
    zeros = {name: np.zeros(boats) for name in terms}
    return {"outcome": nothing, "collided_with": nothing.copy(), "reward_terms": zeros}


def events_of(status: StepStatus, truncated: Bools, by_term: dict[str, Floats], simulator: Simulator) -> Info:
    """Return how episodes ended in a step, what was hit, and the reward by term, (n,) each."""
    collided_with = np.full(len(truncated), "", object)
    for row in np.flatnonzero(status.collided).tolist():
        collided_with[row] = simulator.obstacles(row).collided_part(simulator.eta[row]) or ""
    return {"outcome": status.outcome(truncated), "collided_with": collided_with, "reward_terms": by_term}


def without(events: Info, rows: Bools) -> Info:
    """Return the events, cleared for the boats where `rows` (n,) is true."""
    texts = {key: np.where(rows, "", events[key]) for key in ("outcome", "collided_with")}
    terms = events["reward_terms"].items()
    return {**texts, "reward_terms": {name: np.where(rows, 0.0, value) for name, value in terms}}


def masked(info: Info, mask: Bools) -> Info:
    """Return `info` with a mask `_key` for every key, as in Gymnasium's vector environments."""
    result: Info = {}
    for key, value in info.items():
        result[key] = masked(value, mask) if isinstance(value, dict) else value
        result[f"_{key}"] = mask
    return result
