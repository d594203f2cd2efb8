"""Checks of a scenario in its harbors: poses, random starts, berths and meshes; notes for the user."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dockctl.errors import InputError
from dockctl.geometry import Floats, pose_array, pose_label, to_world
from dockctl.scenarios.base import FieldError, Pose
from dockctl.scenarios.harbor import Generated, Marina
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import LoadedScenario, load
from dockctl.scenarios.schema import TRAINING_CONDITIONS, Scenario
from dockctl.sim.collision import CollisionChecker, collision_checker, overlapping_vessels
from dockctl.sim.disturbances import ConditionError, Disturbances
from dockctl.sim.harbor.build import Harbor, build_harbor, open_bodies
from dockctl.sim.harbor.solids import hull_outline
from dockctl.sim.simulator import IntegrationError
from dockctl.sim.starts import UNREACHABLE, blocked_berths, free_sites, own_site, rejected_shares

MAX_REJECTED, NOTED_REJECTED = 0.95, 0.3
"""Fractions of unreachable random starts above which there is an error, or a note."""
LITTLE_USED = 0.8
"""Fraction of the vessel's limits below which actions are noted."""
CHECKED_LAYOUTS = 3
"""Number of generated layouts of each kind whose starts are checked; the others follow the same rules."""
SHOWN_OVERLAPS = 3
"""Number of overlapping vessels that a note names."""
SEARCH_RADII_M = np.arange(1, 41) * 0.25
SEARCH_DIRECTIONS = np.array([(math.cos(a), math.sin(a), 0.0) for a in np.arange(16) * (math.pi / 8)])


def load_checked(
    source: str | Path,
    *,
    overrides: Sequence[str] = (),
    plugin_files: Sequence[Path] = (),
    received: bool = False,
    trust: bool = False,
) -> LoadedScenario:
    """Load `source` as `load` does, and check its conditions, mesh files, and that no pose is blocked.

    Raises:
        InputError: all problems of the scenario, with their locations.
        DockctlError: the scenario or a plugin does not exist.
    """
    loaded = load(source, overrides=overrides, plugin_files=plugin_files, received=received, trust=trust)
    with located(loaded):
        Disturbances(loaded.scenario, 1)
    with located(loaded, TRAINING_CONDITIONS):
        Disturbances(loaded.scenario.with_training_conditions(), 1)
    try:
        found = check_poses(loaded.scenario, loaded.base_dir)
    except InputError as error:  # of a mesh file: the field is known, but not its line
        of_file = (loaded.problem(p.field, str(replace(p, field="")), p.code) for p in error.problems)
        raise InputError(list(of_file)) from None
    if found.problems:
        raise InputError([loaded.problem(*each) for each in found.problems])
    return replace(loaded, rejected_starts=found.rejected_starts, blocked_berths=found.blocked_berths)


@contextmanager
def located(loaded: LoadedScenario, conditions: str = "conditions") -> Iterator[None]:
    """Convert an error of a field that shows only in the block to an `InputError` at its location.

    Divergence of the integration is attributed to the conditions: the vessel's validator checked the rest.

    Args:
        conditions: field with the scenario's conditions.

    Raises:
        InputError: the block raised a `FieldError`, or a condition does not match the vessel or range sensor.
    """
    try:
        yield
    except FieldError as error:
        problem = loaded.problem(error.field, error.message, error.code, error.suggestion)
        raise InputError([problem]) from None
    except IntegrationError as error:
        raise InputError([loaded.problem(conditions, error.message, error.code)]) from None
    except ConditionError as error:
        field = conditions + error.field.removeprefix("conditions")
        raise InputError([loaded.problem(field, error.reason, error.code)]) from None


class PoseFindings(NamedTuple):
    """What `check_poses` found.

    Attributes:
        problems: field path and message of each problem.
        rejected_starts, blocked_berths: see `LoadedScenario`.
    """

    problems: list[tuple[str, str]]
    rejected_starts: Mapping[str, float] = {}
    blocked_berths: Mapping[str, Sequence[str]] = {}


def check_poses(scenario: Scenario, base_dir: Path) -> PoseFindings:
    """Check every start, goal and test pose, and try random starts.

    The final pose of a task that is relocated to berths must be the pose of one of them, some berths of each
    kind must be free, and enough random starts must be reachable.

    Raises:
        InputError: a mesh file of the harbor is missing or damaged.
        DockctlError: the harbor cannot be built.
    """
    scenario = with_few_layouts(scenario)
    every = layouts(scenario.harbor, scenario.task.berths)
    harbors = [build_harbor(layout.harbor, base_dir) for layout in every]
    try:
        check = PoseCheck.build(scenario, harbors[own_site(scenario).harbor])
        checked = ((".".join(map(str, keys)), check.problem(pose)) for keys, pose in scenario.poses())
        if found := [(field, reason) for field, reason in checked if reason]:
            return PoseFindings(found)
        unreachable = [collision_checker(harbor, scenario.vessel.hull).unreachable for harbor in harbors]
        free = free_sites(scenario, unreachable)
    except InputError as error:  # the task does not match its berths
        return PoseFindings([(problem.field, problem.message) for problem in error.problems])
    shares = rejected_shares(scenario, unreachable, free)
    advice = f"{UNREACHABLE}; reduce the offsets, or move the pose"
    excessive = ((field, share) for field, share in shares.items() if share > MAX_REJECTED)
    problems = [(field, f"{share:.0%} of the poses drawn here {advice}") for field, share in excessive]
    # Only a few of the generated layouts were checked, and some berths are always blocked in these.
    blocked = {} if isinstance(scenario.harbor, Generated) else blocked_berths(scenario, free)
    return PoseFindings(problems, shares, blocked)


def with_few_layouts(scenario: Scenario) -> Scenario:
    """Return the scenario with at most `CHECKED_LAYOUTS` generated layouts of each kind, for checks."""
    if not isinstance(harbor := scenario.harbor, Generated):
        return scenario
    few = {name: min(getattr(harbor, name), CHECKED_LAYOUTS) for name in ("layouts", "held_out_layouts")}
    return scenario.model_copy(update={"harbor": harbor.model_copy(update=few)})


def notes(loaded: LoadedScenario) -> list[str]:
    """Return notes for the user on a scenario that `load_checked` returned.

    They concern starts that are redrawn, berths that are left out, open meshes, moored vessels that overlap,
    and conditions beyond the vessel's control authority.
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
                    f"{number} of its bodies are open, so that a boat inside them is not detected;"
                    " contact with their surfaces is. Close the mesh to detect both",
                )
            )
            for field, number in open_bodies(scenario.harbor, loaded.base_dir).items()
        ]
        + _overlaps(loaded)
        + [str(loaded.problem(*note)) for note in beyond_authority(scenario)]
    )


def _overlaps(loaded: LoadedScenario) -> list[str]:
    """Return a note on moored vessels that touch something, if the marina has some; no layout has."""
    spec = loaded.scenario.harbor
    pairs = overlapping_vessels(build_harbor(spec, loaded.base_dir)) if isinstance(spec, Marina) else []
    if not pairs:
        return []
    shown = [f"the {vessel} and the {other}" for vessel, other in pairs[:SHOWN_OVERLAPS]]
    more = f" and {len(pairs) - len(shown)} more" if len(pairs) > len(shown) else ""
    return [
        str(loaded.problem("harbor.rows", f"overlapping: {'; '.join(shown)}{more}. Move or free the berths"))
    ]


def unused_authority(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield field and message if no action uses most of the vessel's propeller force or rudder angle."""
    vessel = scenario.vessel
    commands = scenario.actions.command_table(vessel)
    if commands is not None:
        force, angle = np.abs(commands).max(axis=0)
        if force < LITTLE_USED * vessel.max_propeller_n:
            yield "actions", f"use at most {force:g} of the {vessel.max_propeller_n:g} N of the propeller"
        if (degrees := round(math.degrees(angle), 6)) < LITTLE_USED * vessel.max_rudder_deg:
            yield "actions", f"use at most {degrees:g}° of the {vessel.max_rudder_deg:g}° of the rudder"


def beyond_authority(scenario: Scenario) -> Iterator[tuple[str, str]]:
    """Yield field and message for conditions beyond the vessel's control authority, alone or together."""
    vessel, trained = scenario.vessel, scenario.with_training_conditions().conditions
    for section, given, effective in (
        ("conditions", scenario.conditions, scenario.conditions),
        (TRAINING_CONDITIONS, scenario.training.conditions, trained),
    ):
        for name, condition in given.items():
            for field, message in condition.notes(vessel):
                yield f"{section}.{name}.{field}", message
        forces = [condition.side_force_n(vessel) for condition in effective.values()] if given else []
        if max(forces, default=0.0) <= vessel.max_side_n < sum(forces):
            yield (
                section,
                f"together they take up to {sum(forces):.0f} N sideways to hold the boat in place; the vessel"
                f" has {vessel.max_side_n:.0f} N",
            )


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
            return "is not connected to the final pose by water" if separated else ""
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
