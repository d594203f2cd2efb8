"""What only the built harbor can tell about a scenario: are its poses free, and in the water?"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dockctl.errors import InputError
from dockctl.geometry import place_outline, pose_array
from dockctl.scenarios.base import Pose
from dockctl.scenarios.berths import layouts
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.collision import CollisionChecker, collision_checker
from dockctl.sim.harbor.build import Harbor, build_harbor
from dockctl.sim.hull import hull_outline
from dockctl.sim.sites import free_sites, own_site

Floats = NDArray[np.float64]

SEARCH_RADII_M = np.arange(1, 41) * 0.25
SEARCH_DIRECTIONS = np.array([(math.cos(a), math.sin(a), 0.0) for a in np.arange(16) * (math.pi / 8)])


def load_checked(
    source: str | Path, *, overrides: Sequence[str] = (), plugin_files: Sequence[Path] = ()
) -> LoadedScenario:
    """Load `source` and make sure that its meshes are there and that no pose lies inside an obstacle.

    Raises:
        InputError: every problem of the scenario, each with its place.
        DockctlError: the scenario or a plugin does not exist.
    """
    loaded = load(source, overrides=overrides, plugin_files=plugin_files)
    try:
        found = check_poses(loaded.scenario, loaded.base_dir)
    except InputError as error:  # a mesh file, which knows the field that names it but not the line
        found = [(problem.field, f"{problem.file} {problem.message}") for problem in error.problems]
    if found:
        raise InputError(loaded.problem(path, message) for path, message in found) from None
    return loaded


def check_poses(scenario: Scenario, base_dir: Path) -> list[tuple[str, str]]:
    """Return (field path, message) for every start, goal and test pose at which the boat is not free.

    A task that is carried to berths must be written for one of them, and find room at some of each kind.

    Raises:
        InputError: a mesh file of the harbor is missing or broken.
        DockctlError: the harbor cannot be built.
    """
    harbors = [
        build_harbor(layout.harbor, base_dir) for layout in layouts(scenario.harbor, scenario.task.berths)
    ]
    try:
        check = PoseCheck.of(scenario, harbors[own_site(scenario).harbor])
        if flaws := [(field, flaw) for field, pose in _poses(scenario) if (flaw := check.flaw(pose))]:
            return flaws
        hull = scenario.vessel.hull
        free_sites(scenario, [collision_checker(harbor, hull).blocked for harbor in harbors])
    except InputError as error:  # the task and its berths do not go together
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
    """Says in words why a pose is not free."""

    def __init__(
        self, checker: CollisionChecker, basin: tuple[float, float, float, float] | None, outline: Floats
    ) -> None:
        self._checker = checker
        self._basin = basin
        self._outline = outline

    @classmethod
    def of(cls, scenario: Scenario, harbor: Harbor) -> PoseCheck:
        """Check the scenario's vessel in its harbor."""
        hull = scenario.vessel.hull
        return cls(collision_checker(harbor, hull), harbor.basin, hull_outline(hull))

    def free(self, eta: Floats) -> bool:
        """Whether the boat at a pose (3,) [m, m, rad] touches nothing and lies over the basin."""
        return self._checker.collided_part(eta) is None and self._afloat(eta)

    def flaw(self, pose: Pose) -> str:
        """Return what is wrong with a pose and what would be right, or an empty string."""
        eta = pose_array(pose)
        part = self._checker.collided_part(eta)
        if part is None and self._afloat(eta):
            return ""
        boat = f"the boat at ({pose.x_m:g}, {pose.y_m:g}, {pose.heading_deg:g}°)"
        trouble = f"is blocked by the {part}" if part else "is outside of the basin"
        return f"{boat} {trouble}; {self._remedy(eta)}"

    def _afloat(self, eta: Floats) -> bool:
        """Whether the whole outline lies over the basin; mesh harbors have no known basin."""
        if self._basin is None:
            return True
        points = place_outline(self._outline, eta)
        return bool(((points > self._basin[:2]) & (points < self._basin[2:])).all())

    def _remedy(self, eta: Floats) -> str:
        """Look for the nearest free place with the same heading."""
        for radius in SEARCH_RADII_M:
            places = eta + radius * SEARCH_DIRECTIONS
            for place in filter(self._afloat, places[~self._checker.blocked(places)]):
                return f"the nearest free place with this heading is about ({place[0]:.2f}, {place[1]:.2f})"
        if self._basin is None:
            return f"no place within {SEARCH_RADII_M[-1]:g} m is free"
        x0, y0, x1, y1 = self._basin
        return f"the basin is x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m"
