"""Harbors as the simulator uses them: obstacles, range sensor and plan view; checks of poses in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple, Protocol, SupportsIndex, overload

import numpy as np

from dockctl.compute import on_all_cores, shared
from dockctl.drawing.scene import Scene
from dockctl.errors import InputError
from dockctl.geometry import Bools, Floats, pose_array, pose_label, read_only, to_world
from dockctl.plugins import RANGE_SENSORS, Guard
from dockctl.scenarios.base import Pose
from dockctl.scenarios.extensions import RangeNoise, RangeSensor, RangeSensorSpec
from dockctl.scenarios.harbor import Generated, HarborSpec
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import Scenario
from dockctl.scenarios.vessel import Hull
from dockctl.sim.collision import CollisionChecker, collision_checker
from dockctl.sim.harbor.build import Harbor, build_harbor, build_scene, open_bodies
from dockctl.sim.harbor.solids import hull_outline
from dockctl.sim.starts import (
    UNREACHABLE,
    Near,
    Unreachable,
    blocked_berths,
    free_sites,
    own_site,
    rejected_shares,
)

MAX_REJECTED, NOTED_REJECTED = 0.95, 0.3
"""Shares of random starts: more are an error, or are noted."""
CHECKED_LAYOUTS = 3
"""Generated layouts of each kind whose starts are checked; the others follow the same rules."""
SEARCH_RADII_M = np.arange(1, 41) * 0.25
SEARCH_DIRECTIONS = np.array([(math.cos(a), math.sin(a), 0.0) for a in np.arange(16) * (math.pi / 8)])


class Obstacles(Protocol):
    """What a boat can collide with. Poses `eta` are (n, 3) x, y [m] and heading [rad]."""

    def near(self, eta: Floats, within_m: float) -> Bools:
        """Return whether the hull can touch something if its points move at most this far, (n,)."""
        ...

    def blocked(self, eta: Floats) -> Bools:
        """Return whether the hull touches something or is inside of it, (n,)."""
        ...

    def unreachable(self, eta: Floats, goal: Floats) -> Bools:
        """Return whether poses are blocked or not connected by water with the goal (3,), (n,)."""
        ...

    def collided_part(self, eta: Floats) -> str | None:
        """Return the name of what the hull touches at one pose (3,)."""
        ...

    def clearance(self, eta: Floats) -> Floats:
        """Return the least distance (n,) [m] between the hull and anything."""
        ...

    def clearance_below(self, eta: Floats, limit_m: float) -> Floats:
        """Return `clearance` where it is less than `limit_m`, else `limit_m`, (n,) [m]."""
        ...


Source = tuple[HarborSpec, Path, Hull, RangeSensorSpec]


@dataclass(frozen=True, eq=False)
class World:
    """One harbor, built once and shared by all simulators, and by their copies.

    Attributes:
        scene: returns the plan view.
        source: what it was built from; a pickle consists of it.
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
    """The worlds of a scenario; each is built when it is used for the first time."""

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
    """Return for each harbor whether poses are unreachable there; a world is built when it is queried."""

    def ask(number: int, eta: Floats, goal: Floats) -> Bools:
        return worlds[number].obstacles.unreachable(eta, goal)

    return [partial(ask, number) for number in range(len(worlds))]


def near_in(worlds: Sequence[World]) -> Near:
    """Return whether an obstacle of a start's harbor is within a distance of the hull, as a function."""
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
        PluginError: the sensor is a plugin's, and fails.
    """
    with Guard(RANGE_SENSORS, lidar.kind):
        return lidar.build(read_only(harbor.triangles))  # others use the array, too


def scan_points(sensor: RangeSensor, kind: str, pose: Floats, every: int = 1) -> Floats:
    """Return the points (k, 3) [m] of a scan by a sensor of this kind, in the body frame.

    Raises:
        PluginError: the sensor is a plugin's, and fails or returns another shape.
    """
    with Guard(RANGE_SENSORS, kind):
        points = np.asarray(sensor.points(pose, every), float)
        if points.shape != (len(points), 3):
            raise ValueError(f"points returned shape {points.shape}, expected (points, 3)")
        if not np.isfinite(points).all():
            raise ValueError("points returned a number that is not finite")
        return points


def scan_sectors(sensor: RangeSensor, spec: RangeSensorSpec, pose: Floats) -> Floats:
    """Return the nearest return (sectors,) [m] of each sector of a scan from a pose (3,).

    Raises:
        PluginError: the sensor is a plugin's, and fails, or returns another shape or what is no range.
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
        return np.full(len(eta), 100.0)

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
    """Run one scan in each of these worlds, to build the tables of the sensors now and in parallel."""
    if not worlds:
        return
    first, *others = (world.lidar for world in worlds)
    first.sector_ranges(np.zeros((1, 3)))  # compiles, and builds what all share
    on_all_cores(lambda sensor: sensor.sector_ranges(np.zeros((1, 3))), others)


def load_checked(
    source: str | Path,
    *,
    overrides: Sequence[str] = (),
    plugin_files: Sequence[Path] = (),
    received: bool = False,
    trust: bool = False,
) -> LoadedScenario:
    """Load `source` as `load` does, and check its mesh files and that none of its poses is blocked.

    Raises:
        InputError: all problems of the scenario, with their locations.
        DockctlError: the scenario or a plugin does not exist.
    """
    loaded = load(source, overrides=overrides, plugin_files=plugin_files, received=received, trust=trust)
    try:
        found = check_poses(loaded.scenario, loaded.base_dir)
    except InputError as error:  # of a mesh file: the field is known, but not its line
        of_file = (loaded.problem(p.field, str(replace(p, field="")), p.code) for p in error.problems)
        raise InputError(list(of_file)) from None
    if found.problems:
        raise InputError([loaded.problem(*each) for each in found.problems])
    return replace(loaded, rejected_starts=found.rejected_starts, blocked_berths=found.blocked_berths)


class PoseFindings(NamedTuple):
    """What `check_poses` found.

    Attributes:
        problems: field path and message of each.
        rejected_starts, blocked_berths: see `LoadedScenario`.
    """

    problems: list[tuple[str, str]]
    rejected_starts: Mapping[str, float] = {}
    blocked_berths: Mapping[str, Sequence[str]] = {}


def check_poses(scenario: Scenario, base_dir: Path) -> PoseFindings:
    """Check every start, goal and test pose, and try random starts.

    The final pose of a task that is relocated to berths must be the pose of one of them, some berths of each
    kind must be free, and so must a share of the random starts.

    Raises:
        InputError: a mesh file of the harbor is missing or damaged.
        DockctlError: the harbor cannot be built.
    """
    scenario = with_few_layouts(scenario)
    every = layouts(scenario.harbor, scenario.task.berths)
    harbors = [build_harbor(layout.harbor, base_dir) for layout in every]
    try:
        check = PoseCheck.build(scenario, harbors[own_site(scenario).harbor])
        if found := [(field, reason) for field, pose in _poses(scenario) if (reason := check.problem(pose))]:
            return PoseFindings(found)
        unreachable = [collision_checker(harbor, scenario.vessel.hull).unreachable for harbor in harbors]
        free = free_sites(scenario, unreachable)
    except InputError as error:  # the task does not match its berths
        return PoseFindings([(problem.field, problem.message) for problem in error.problems])
    shares = rejected_shares(scenario, unreachable, free)
    advice = f"{UNREACHABLE}; reduce the offsets, or move the pose"
    excessive = ((field, share) for field, share in shares.items() if share > MAX_REJECTED)
    problems = [(field, f"{share:.0%} of the poses drawn here {advice}") for field, share in excessive]
    # Of generated layouts, only a few were checked, in which some berths are always blocked.
    blocked = {} if isinstance(scenario.harbor, Generated) else blocked_berths(scenario, free)
    return PoseFindings(problems, shares, blocked)


def with_few_layouts(scenario: Scenario) -> Scenario:
    """Return the scenario with at most `CHECKED_LAYOUTS` generated layouts of each kind, for checks."""
    if not isinstance(harbor := scenario.harbor, Generated):
        return scenario
    few = {name: min(getattr(harbor, name), CHECKED_LAYOUTS) for name in ("layouts", "held_out_layouts")}
    return scenario.model_copy(update={"harbor": harbor.model_copy(update=few)})


def notes(loaded: LoadedScenario) -> list[str]:
    """Return what a user should know about a scenario that `load_checked` returned.

    Starts that are drawn again, berths that are left out, open meshes, and conditions beyond the vessel's
    control authority.
    """
    scenario = loaded.scenario
    return (
        [
            f"{field}: {share:.0%} of the poses drawn here {UNREACHABLE}, and are drawn again"
            for field, share in loaded.rejected_starts.items()
            if share > NOTED_REJECTED
        ]
        + [
            str(loaded.problem(field, f"left out, a pose of the task is blocked there: {', '.join(names)}"))
            for field, names in loaded.blocked_berths.items()
        ]
        + [
            str(
                loaded.problem(
                    field,
                    f"{number} of its bodies are open, so that a boat inside them is not found;"
                    " contact with their surfaces is. Close the mesh to test for both",
                )
            )
            for field, number in open_bodies(scenario.harbor, loaded.base_dir).items()
        ]
        + [
            str(loaded.problem(f"conditions.{name}.{field}", message))
            for name, condition in scenario.conditions.items()
            for field, message in condition.notes(scenario.vessel)
        ]
        + [str(loaded.problem("conditions", message)) for message in _together(scenario)]
    )


def _together(scenario: Scenario) -> Iterator[str]:
    """Yield a message if conditions exceed the control authority only together."""
    vessel = scenario.vessel
    forces = [condition.side_force_n(vessel) for condition in scenario.conditions.values()]
    if max(forces, default=0.0) <= vessel.max_side_n < sum(forces):
        yield (
            f"together they take up to {sum(forces):.0f} N sideways to hold the boat in place; the vessel has"
            f" {vessel.max_side_n:.0f} N"
        )


def _poses(scenario: Scenario) -> Iterator[tuple[str, Pose]]:
    task = scenario.task
    yield from ((f"task.initial.{i}", pose) for i, pose in enumerate(task.initial))
    if task.intermediate is not None:
        yield "task.intermediate", task.intermediate
    yield "task.final", task.final
    yield from ((f"evaluation.poses.{i}", pose) for i, pose in enumerate(scenario.evaluation.poses))


class PoseCheck:
    """Checks poses of one vessel in one harbor, and describes why a pose is not free."""

    def __init__(
        self,
        checker: CollisionChecker,
        basin: tuple[float, float, float, float] | None,
        outline: Floats,
        final: Floats,
    ) -> None:
        self._checker, self._final = checker, final
        self._basin = basin
        self._outline = outline

    @classmethod
    def build(cls, scenario: Scenario, harbor: Harbor) -> PoseCheck:
        """Return the check for the vessel of a scenario in one of its harbors."""
        hull = scenario.vessel.hull
        final = pose_array(scenario.task.final)
        return cls(collision_checker(harbor, hull), harbor.basin, hull_outline(hull), final)

    def free(self, eta: Floats) -> bool:
        """Return whether the boat can be at a pose (3,) [m, m, rad] and move from there to the final pose."""
        return not self._obstruction(eta)

    def problem(self, pose: Pose) -> str:
        """Return why a pose is not free and the nearest free one, or an empty string."""
        eta = pose_array(pose)
        if not (obstruction := self._obstruction(eta)):
            return ""
        return f"the boat at {pose_label(pose.x_m, pose.y_m, pose.heading_deg)} {obstruction}"

    def _obstruction(self, eta: Floats) -> str:
        """Return why the pose (3,) is not free, or an empty string."""
        if part := self._checker.collided_part(eta):
            return f"is blocked by the {part}; {self._nearest_free(eta)}"
        if not self._in_basin(eta):
            return f"is outside the basin; {self._nearest_free(eta)}"
        if self._in_basin(self._final) and not self._checker.blocked(self._final[None])[0]:
            separated = self._checker.unreachable(eta[None], self._final)[0]
            return "is not connected by water with the final pose" if separated else ""
        return ""

    def _in_basin(self, eta: Floats) -> bool:
        """Return whether the whole outline is in the basin; a harbor of mesh files has no basin."""
        if self._basin is None:
            return True
        points = to_world(self._outline, eta)
        return bool(((points > self._basin[:2]) & (points < self._basin[2:])).all())

    def _nearest_free(self, eta: Floats) -> str:
        """Describe the nearest free position with the same heading."""
        for radius in SEARCH_RADII_M:
            candidates = eta + radius * SEARCH_DIRECTIONS
            for pose in filter(self._in_basin, candidates[~self._checker.blocked(candidates)]):
                return f"the nearest free position with this heading is about ({pose[0]:.2f}, {pose[1]:.2f})"
        if self._basin is None:
            return f"no position within {SEARCH_RADII_M[-1]:g} m is free"
        x0, y0, x1, y1 = self._basin
        return f"the basin is x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m"
