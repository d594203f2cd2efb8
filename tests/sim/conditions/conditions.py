"""Simulators and environments with conditions, in open water or a walled basin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import given_start, own_site
from dockctl.testing.environments import open_water


def scenario(conditions: str, *overrides: str) -> LoadedScenario:
    """Return scenario 1 with these conditions, the text of a YAML mapping."""
    return load("s1", overrides=[f"conditions={{{conditions}}}", *overrides])


def simulator(
    conditions: str, *overrides: str, boats: int = 1, pose: Any = (20.0, 2.0, 2.7), first_seed: int = 0
) -> Simulator:
    """Return boats at rest at a pose in open water, each with a generator of its own."""
    model = scenario(conditions, *overrides).scenario
    sim = Simulator(model, [open_water()], boats)
    start = replace(given_start(own_site(model), model.task, np.array(pose), 0), max_steps=100_000)
    seeds = range(first_seed, first_seed + boats)
    sim.reset(np.arange(boats), [start] * boats, [np.random.default_rng(seed) for seed in seeds])
    return sim
