"""Checks of a scenario that need the built harbor: whether its poses are free and in the water."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from dockctl.errors import InputError
from dockctl.geometry import Floats, place_outline, pose_array
from dockctl.scenarios.base import Pose
from dockctl.scenarios.harbor import layouts
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.collision import CollisionChecker, collision_checker
from dockctl.sim.harbor.build import Harbor, build_harbor
from dockctl.sim.harbor.solids import hull_outline
from dockctl.sim.starts import free_sites, own_site

SEARCH_RADII_M = np.arange(1, 41) * 0.25
SEARCH_DIRECTIONS = np.array([(math.cos(a), math.sin(a), 0.0) for a in np.arange(16) * (math.pi / 8)])


def load_checked(
    source: str | Path, *, overrides: Sequence[str] = (), plugin_files: Sequence[Path] = ()
) -> LoadedScenario:
    """Load `source` and check its mesh files and that none of its poses is blocked.

    Raises:
        InputError: all problems of the scenario, with their locations.
        DockctlError: the scenario or a plugin does not exist.
    """
    loaded = load(source, overrides=overrides, plugin_files=plugin_files)
    try:
        problems = [loaded.problem(*found) for found in check_poses(loaded.scenario, loaded.base_dir)]
    except InputError as error:  # of a mesh file: the field is known, but not its line
        problems = [loaded.problem(p.field, str(replace(p, field="")), p.code) for p in error.problems]
    if problems:
        raise InputError(problems)
    return loaded


def check_poses(scenario: Scenario, base_dir: Path) -> list[tuple[str, str]]:
    """Return (field path, message) for every start, goal and test pose that is not free.

    The final pose of a task that is transferred to berths must be the pose of one of them, and some berths of
    each kind must be free.

    Raises:
        InputError: a mesh file of the harbor is missing or damaged.
        DockctlError: the harbor cannot be built.
    """
    harbors = [
        build_harbor(layout.harbor, base_dir) for layout in layouts(scenario.harbor, scenario.task.berths)
    ]
    try:
        check = PoseCheck.of(scenario, harbors[own_site(scenario).harbor])
        if found := [(field, reason) for field, pose in _poses(scenario) if (reason := check.problem(pose))]:
            return found
        hull = scenario.vessel.hull
        free_sites(scenario, [collision_checker(harbor, hull).blocked for harbor in harbors])
    except InputError as error:  # the task does not match its berths
        return [(problem.field, problem.message) for problem in error.problems]
    return []


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
        self, checker: CollisionChecker, basin: tuple[float, float, float, float] | None, outline: Floats
    ) -> None:
        self._checker = checker
        self._basin = basin
        self._outline = outline

    @classmethod
    def of(cls, scenario: Scenario, harbor: Harbor) -> PoseCheck:
        """Return the check for the vessel of a scenario in one of its harbors."""
        hull = scenario.vessel.hull
        return cls(collision_checker(harbor, hull), harbor.basin, hull_outline(hull))

    def free(self, eta: Floats) -> bool:
        """Return whether the boat at a pose (3,) [m, m, rad] touches nothing and is in the basin."""
        return self._checker.collided_part(eta) is None and self._in_basin(eta)

    def problem(self, pose: Pose) -> str:
        """Return why a pose is not free and the nearest free one, or an empty string."""
        eta = pose_array(pose)
        part = self._checker.collided_part(eta)
        if part is None and self._in_basin(eta):
            return ""
        boat = f"the boat at ({pose.x_m:g}, {pose.y_m:g}, {pose.heading_deg:g}°)"
        trouble = f"is blocked by the {part}" if part else "is outside the basin"
        return f"{boat} {trouble}; {self._nearest_free(eta)}"

    def _in_basin(self, eta: Floats) -> bool:
        """Return whether the whole outline is in the basin; a harbor of mesh files has no basin."""
        if self._basin is None:
            return True
        points = place_outline(self._outline, eta)
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
