"""Harbors as the simulator uses them: obstacles, the range sensor in them, and their plan view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import Protocol

import numpy as np

from dockctl.compute.threads import workers
from dockctl.drawing.scene import Scene
from dockctl.geometry import Bools, Floats
from dockctl.scenarios.extensions import RangeSensor, RangeSensorSpec
from dockctl.scenarios.harbor import layouts
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Hull
from dockctl.sim.collision import collision_checker
from dockctl.sim.harbor.build import Harbor, build_harbor, scene_of


class Obstacles(Protocol):
    """What a boat can collide with. Poses `eta` are (n, 3) x, y [m] and heading [rad]."""

    def collides(self, eta: Floats) -> Bools:
        """Return whether the hull touches something, (n,)."""
        ...

    def blocked(self, eta: Floats) -> Bools:
        """Return whether the hull touches something or is inside of it, (n,)."""
        ...

    def collided_part(self, eta: Floats) -> str | None:
        """Return the name of what the hull touches at one pose (3,)."""
        ...

    def clearance(self, eta: Floats) -> Floats:
        """Return the least distance (n,) [m] between the hull and anything."""
        ...


@dataclass(frozen=True, eq=False)
class World:
    """One harbor, built once and shared by all simulators; `scene` returns its plan view."""

    obstacles: Obstacles
    lidar: RangeSensor
    scene: Callable[[], Scene]


def build_worlds(scenario: Scenario, base_dir: Path) -> tuple[World, ...]:
    """Return a world for each harbor of a scenario, in the order of `layouts`.

    Args:
        base_dir: folder that mesh paths are relative to.

    Raises:
        DockctlError: a harbor cannot be built.
    """
    hull, lidar = scenario.vessel.hull, scenario.sensors.lidar
    specs = (layout.harbor for layout in layouts(scenario.harbor, scenario.task.berths))
    return tuple(_world(build_harbor(spec, base_dir), hull, lidar) for spec in specs)


@lru_cache(maxsize=16)
def _world(harbor: Harbor, hull: Hull, lidar: RangeSensorSpec) -> World:
    return World(
        obstacles=collision_checker(harbor, hull),
        lidar=lidar.build(harbor.triangles),
        scene=cache(partial(scene_of, harbor, hull)),
    )


def prepare(worlds: Sequence[World]) -> None:
    """Scan once in each world, so that the sensors build their tables now and side by side."""
    first, *others = (world.lidar for world in worlds)
    first.sector_ranges(np.zeros((1, 3)))  # compiles, and builds what all share
    list(workers().map(lambda sensor: sensor.sector_ranges(np.zeros((1, 3))), others))
