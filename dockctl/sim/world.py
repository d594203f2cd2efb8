"""Harbors as the simulator uses them: obstacles, range sensor and plan view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, SupportsIndex, overload

import numpy as np

from dockctl.compute import on_all_cores, shared
from dockctl.drawing.scene import Scene
from dockctl.geometry import Bools, Floats, read_only
from dockctl.plugins import RANGE_SENSORS, Guard
from dockctl.scenarios.extensions import RangeNoise, RangeSensor, RangeSensorSpec
from dockctl.scenarios.harbor import HarborSpec
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Hull
from dockctl.sim.collision import Obstacles, collision_checker
from dockctl.sim.harbor.build import Harbor, build_harbor, build_scene
from dockctl.sim.starts import (
    Near,
    Unreachable,
)

Source = tuple[HarborSpec, Path, Hull, RangeSensorSpec]


@dataclass(frozen=True, eq=False)
class World:
    """One harbor, built once and shared by all simulators, and by their copies.

    Attributes:
        scene: returns the plan view.
        source: what it was built from; only this is pickled.
    """

    obstacles: Obstacles
    lidar: RangeSensor
    scene: Callable[[], Scene]
    source: Source | None = None

    def __deepcopy__(self, memo: object) -> World:
        return self

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        return (_world, self.source) if self.source else super().__reduce_ex__(protocol)


class Worlds(Sequence[World]):
    """The worlds of a scenario; each is built on first use."""

    def __init__(self, sources: Sequence[Source]) -> None:
        self._sources = tuple(sources)
        self._built: dict[int, World] = {}

    def __len__(self) -> int:
        return len(self._sources)

    @overload
    def __getitem__(self, index: int) -> World: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[World, ...]: ...
    def __getitem__(self, index: int | slice) -> World | tuple[World, ...]:
        """Return a world, or several.

        Raises:
            DockctlError: a harbor cannot be built.
        """
        numbers = range(len(self))[index]  # raises IndexError
        if isinstance(numbers, range):
            return tuple(self[number] for number in numbers)
        if numbers not in self._built:
            self._built[numbers] = _world(*self._sources[numbers])
        return self._built[numbers]

    def __deepcopy__(self, memo: object) -> Worlds:
        return self


def build_worlds(scenario: Scenario, base_dir: Path) -> Worlds:
    """Return a world for each harbor of a scenario, in the order of `layouts`.

    Args:
        base_dir: folder that mesh paths are relative to.
    """
    hull, lidar = scenario.vessel.hull, scenario.sensors.lidar
    specs = (layout.harbor for layout in layouts(scenario.harbor, scenario.task.berths))
    return Worlds([(spec, base_dir if spec.meshes else Path(), hull, lidar) for spec in specs])


def unreachable_in(worlds: Sequence[World]) -> list[Unreachable]:
    """Return, for each harbor, a function that tests whether poses are unreachable; it builds the world."""

    def unreachable(number: int, eta: Floats, goal: Floats) -> Bools:
        return worlds[number].obstacles.unreachable(eta, goal)

    return [partial(unreachable, number) for number in range(len(worlds))]


def near_in(worlds: Sequence[World]) -> Near:
    """Return a function that tests whether a start has an obstacle within a distance of the hull."""
    return lambda start, within_m: bool(worlds[start.harbor].obstacles.near(start.eta[None], within_m)[0])


def _world(spec: HarborSpec, base_dir: Path, hull: Hull, lidar: RangeSensorSpec) -> World:
    return _in_harbor(build_harbor(spec, base_dir), hull, lidar, (spec, base_dir, hull, lidar))


@shared(lambda world: world.lidar.table_bytes)
def _in_harbor(harbor: Harbor, hull: Hull, lidar: RangeSensorSpec, source: Source) -> World:
    return World(
        obstacles=collision_checker(harbor, hull),
        lidar=build_sensor(harbor, lidar),
        scene=cache(partial(build_scene, harbor, hull)),
        source=source,
    )


def build_sensor(harbor: Harbor, lidar: RangeSensorSpec) -> RangeSensor:
    """Return the range sensor in a harbor.

    Raises:
        PluginError: the sensor is from a plugin, and fails.
    """
    with Guard(RANGE_SENSORS, lidar.kind):
        return lidar.build(read_only(harbor.triangles))  # the array is shared


def scan_points(sensor: RangeSensor, kind: str, pose: Floats, every: int = 1) -> Floats:
    """Return the points (k, 3) [m] of a scan by a sensor of this kind, in the body frame.

    Raises:
        PluginError: the sensor is from a plugin, and fails or returns the wrong shape.
    """
    with Guard(RANGE_SENSORS, kind):
        points = np.asarray(sensor.points(pose, every), float)
        if points.shape != (len(points), 3):
            raise ValueError(f"points returned shape {points.shape}, expected (points, 3)")
        if not np.isfinite(points).all():
            raise ValueError("points returned a value that is not finite")
        return points


def scan_sectors(sensor: RangeSensor, spec: RangeSensorSpec, pose: Floats) -> Floats:
    """Return the range of the nearest return in each sector (sectors,) [m] of a scan from a pose (3,).

    Raises:
        PluginError: the sensor is from a plugin, and fails, or returns the wrong shape or an invalid range.
    """
    with Guard(RANGE_SENSORS, spec.kind):
        ranges: Floats = np.asarray(sensor.sector_ranges(pose[None]), float)
        if ranges.shape != (1, spec.sectors):
            raise ValueError(f"sector_ranges returned shape {ranges.shape}, expected (1, {spec.sectors})")
        if not ((ranges >= 0) & (ranges <= spec.range_m)).all():
            raise ValueError(f"a range is not in 0 to {spec.range_m:g} m")
        return ranges.ravel()


def in_open_water(lidar: RangeSensor) -> World:
    """Return a world without obstacles, with this range sensor."""
    scene = Scene("open water", (), np.zeros((4, 2)), (0.0, 0.0, 50.0, 50.0))
    return World(_NoObstacles(), lidar, lambda: scene)


class _NoObstacles:
    def near(self, eta: Floats, within_m: float) -> Bools:
        return np.zeros(len(eta), bool)

    def blocked(self, eta: Floats) -> Bools:
        return np.zeros(len(eta), bool)

    def unreachable(self, eta: Floats, goal: Floats) -> Bools:
        return self.blocked(eta)

    def collided_part(self, eta: Floats) -> str | None:
        return None

    def clearance(self, eta: Floats) -> Floats:
        return self.approximate_clearance(eta)

    def approximate_clearance(self, eta: Floats) -> Floats:
        return np.full(eta.shape[:-1], 100.0)

    def clearance_below(self, eta: Floats, limit_m: float) -> Floats:
        return np.minimum(self.clearance(eta), limit_m)


@dataclass(frozen=True)
class NothingInRange:
    """A range sensor that never gets a return."""

    spec: RangeSensorSpec
    table_bytes = 0

    def sector_ranges(self, eta: Floats) -> Floats:
        return np.full((len(eta), self.spec.sectors), self.spec.range_m)

    def noisy_sector_ranges(self, eta: Floats, noise: RangeNoise) -> Floats:
        return self.sector_ranges(eta)

    def points(self, pose: Floats, every: int = 1) -> Floats:
        return np.empty((0, 3))


def prepare(worlds: Sequence[World]) -> None:
    """Run one scan in each of these worlds, to build the tables of the sensors now, in parallel."""
    if not worlds:
        return
    first, *others = (world.lidar for world in worlds)
    first.sector_ranges(np.zeros((1, 3)))  # compiles, and builds the shared tables
    on_all_cores(lambda sensor: sensor.sector_ranges(np.zeros((1, 3))), others)
