"""Start poses: the initial poses of the task at each berth, and exploring starts along its path."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from dockctl.errors import InputError, Problem
from dockctl.geometry import Bools, Floats, pose_array, relocate_poses, wrap
from dockctl.scenarios.harbor import BerthKind, BerthPlace, Marina, layouts
from dockctl.scenarios.schema import Scenario, Task
from dockctl.scenarios.training import ExploringStarts
from dockctl.sim.goal import TO_FINAL, TO_INTERMEDIATE, measure
from dockctl.sim.harbor.build import berth_pose

MAX_DRAWS = 100
SAME_POSE = 1e-3
"""Poses that differ by less [m, rad] are equal."""
Blocked = Callable[[Floats], Bools]
"""Whether the boat at poses (n, 3) touches or is inside an obstacle, (n,)."""


@dataclass(frozen=True, eq=False)
class Site:
    """The poses of a task at one berth.

    Attributes:
        initial: (k, 3) initial poses, x, y [m] and heading [rad].
        goals: (2, 3) intermediate and final pose; the final pose twice if the task has no intermediate pose.
        first_phase: phase in which an episode starts.
        harbor: index of the scenario's harbor in which the berth is free.
        kind: "trained" or "held_out"; empty if the task is not relocated to berths.
        berth: its name; empty if the task is not relocated to berths.
    """

    initial: Floats
    goals: Floats
    first_phase: int
    harbor: int = 0
    kind: str = ""
    berth: str = ""


@dataclass(frozen=True)
class Start:
    """How one episode starts.

    Attributes:
        eta: (3,) x, y [m] and heading [rad].
        nu: (3,) u, v [m/s] and r [rad/s].
        phase: 0 on the way to the intermediate pose, 1 on the way to the final pose.
        goals: (2, 3) intermediate and final pose; the final pose twice if the task has no intermediate pose.
        max_steps: control steps until the episode is truncated.
        kind: "pose", "exploring", "random", "trained" or "held_out".
        index: of the initial pose, or of the given pose.
        harbor: index of the harbor that the boat is in.
        berth: name of the berth; empty if the task is not relocated to berths.
        seed: of the random values of the conditions in this episode; None uses the generator of the boat.
    """

    eta: Floats
    nu: Floats
    phase: int
    goals: Floats
    max_steps: int
    kind: str
    index: int
    harbor: int = 0
    berth: str = ""
    seed: int | None = None


def own_site(scenario: Scenario) -> Site:
    """Return the task with the poses that the scenario gives, in the harbor in which its berth is free.

    Raises:
        InputError: the task is relocated to berths, and its final pose is not the pose of one of them.
    """
    own, every = _task_site(scenario.task), sites(scenario)
    distance, turn = measure(np.stack([site.goals[1] for site in every]), own.goals[1:])
    same = np.flatnonzero((distance < SAME_POSE) & (np.abs(turn) < SAME_POSE))
    if not len(same):
        x, y, heading = every[int(distance.argmin())].goals[1]
        message = (
            "is not at any berth in task.berths;"
            f" the nearest berth has ({x:g}, {y:g}, {np.degrees(heading):g}°)"
        )
        raise _error(scenario, "task.final", message)
    return replace(own, harbor=every[same[0]].harbor)


def sites(scenario: Scenario) -> list[Site]:
    """Return every site: the task itself, or each berth with the approach from one side or from both."""
    own, berths = _task_site(scenario.task), scenario.task.berths
    if berths is None:
        return [own]
    assert isinstance(scenario.harbor, Marina)  # checked by the validator of the scenario
    return [
        _relocated(own, berth_pose(scenario.harbor, place), mirrored, harbor, layout.kind or "", place)
        for harbor, layout in enumerate(layouts(scenario.harbor, berths))
        for place in layout.berths
        for mirrored in ((False, True) if berths.mirrored else (False,))
    ]


def free_sites(scenario: Scenario, blocked: Sequence[Blocked]) -> list[Site]:
    """Return the sites whose poses are free: near the end of a quay, one side of a berth may be too narrow.

    Args:
        scenario: the scenario.
        blocked: for each harbor, whether the boat is blocked.

    Raises:
        InputError: none of the trained berths, or none of the held-out berths, is free.
    """
    every, berths = sites(scenario), scenario.task.berths
    if berths is None:
        return every
    free = [
        site for site in every if not blocked[site.harbor](np.concatenate([site.initial, site.goals])).any()
    ]
    for kind in get_args(BerthKind):
        if berths.places(kind) and not any(site.kind == kind for site in free):
            message = "at each of these berths a pose of the task is blocked; name a berth with more space"
            raise _error(scenario, f"task.berths.{kind}", message)
    return free


def _task_site(task: Task) -> Site:
    final = pose_array(task.final)
    intermediate = final if task.intermediate is None else pose_array(task.intermediate)
    phase = TO_FINAL if task.intermediate is None else TO_INTERMEDIATE
    return Site(np.stack([pose_array(pose) for pose in task.initial]), np.stack([intermediate, final]), phase)


def _relocated(
    own: Site, to: tuple[float, float, float], mirrored: bool, harbor: int, kind: str, place: BerthPlace
) -> Site:
    final, target = own.goals[1], np.array(to)
    berth = f"{place.side} {place.at_m:g}{' mirrored' if mirrored else ''}"
    initial, goals = (relocate_poses(poses, final, target, mirrored) for poses in (own.initial, own.goals))
    return Site(initial, goals, own.first_phase, harbor, kind, berth)


def _error(scenario: Scenario, field: str, message: str) -> InputError:
    return InputError([Problem(f"scenario '{scenario.name}'", 0, 0, field, message, "mismatch")])


def given_start(site: Site, task: Task, pose: Floats, index: int, kind: str = "pose") -> Start:
    """Return a start at rest at `pose` (3,) [m, m, rad], in the first phase of the task."""
    eta, rest = np.asarray(pose, float), np.zeros(3)
    return Start(
        eta, rest, site.first_phase, site.goals, task.max_steps, kind, index, site.harbor, site.berth
    )


def initial_start(site: Site, task: Task, rng: np.random.Generator, blocked: Blocked) -> Start:
    """Draw one of the initial poses and its offset; a blocked offset is drawn again."""
    index = int(rng.integers(len(site.initial)))
    initial = task.initial[index]
    start = given_start(site, task, site.initial[index], index)
    return with_offset(
        start, offset_limits(initial.position_offset_m, initial.heading_offset_deg), rng, blocked
    )


def exploring_start(
    site: Site, task: Task, exploring: ExploringStarts, rng: np.random.Generator, blocked: Blocked
) -> Start:
    """Draw an exploring start: a random point on a random leg of the task, with noise of a random size.

    The heading turns along the leg by the smaller angle. If no draw is free, an initial pose is drawn.
    """

    def draw() -> Start:
        index = int(rng.integers(len(site.initial)))
        intermediate, final = site.goals
        begin, end, phase = site.initial[index], final, TO_FINAL
        if site.first_phase == TO_INTERMEDIATE:
            if rng.random() < 0.5:
                begin = intermediate
            else:
                end, phase = intermediate, TO_INTERMEDIATE
        leg = end - begin
        leg[2] = wrap(leg[2])
        eta = begin + rng.random() * leg
        size = rng.random()  # one draw for both: near misses are near in position and in heading
        offsets = offset_limits(
            _interpolate(exploring.position_noise_m, size), _interpolate(exploring.heading_noise_deg, size)
        )
        surge = rng.uniform(-exploring.max_surge_mps, exploring.max_surge_mps)
        start = given_start(site, task, eta + rng.uniform(-offsets, offsets), index, "exploring")
        return replace(start, nu=np.array([surge, 0.0, 0.0]), phase=phase, max_steps=exploring.steps)

    return _first_free(draw, blocked) or initial_start(site, task, rng, blocked)


def draw_intermediate(site: Site, task: Task, rng: np.random.Generator, blocked: Blocked) -> Site:
    """Return the site with its intermediate pose drawn within the offsets that the task gives it."""
    pose = task.intermediate
    if pose is None or not (offsets := offset_limits(pose.position_offset_m, pose.heading_offset_deg)).any():
        return site
    intermediate, final = site.goals
    nominal = given_start(site, task, intermediate, 0)
    return replace(site, goals=np.stack([with_offset(nominal, offsets, rng, blocked).eta, final]))


class StartSampler:
    """Draws the starts of episodes at the sites of one scenario.

    Args:
        scenario: the scenario.
        sites: the sites; one is drawn per episode.
        blocked: for each harbor, whether the boat is blocked.
        exploring: also draw `training.exploring_starts`, as in training; otherwise only initial poses.
    """

    def __init__(
        self,
        scenario: Scenario,
        sites: Sequence[Site],
        blocked: Sequence[Blocked],
        *,
        exploring: bool = False,
    ) -> None:
        self._task, self._sites, self._blocked = scenario.task, sites, blocked
        self._exploring = scenario.training.exploring_starts if exploring else None

    def draw(self, rng: np.random.Generator) -> Start:
        """Draw the start of one episode."""
        site = self._sites[int(rng.integers(len(self._sites)))]
        blocked = self._blocked[site.harbor]
        site = draw_intermediate(site, self._task, rng, blocked)
        if self._exploring is not None and rng.random() < self._exploring.fraction:
            return exploring_start(site, self._task, self._exploring, rng, blocked)
        return initial_start(site, self._task, rng, blocked)


def offset_limits(position_m: float, heading_deg: float) -> Floats:
    """Return the largest offsets in x, y [m] and heading [rad]."""
    return np.array([position_m, position_m, np.radians(heading_deg)])


def _interpolate(bounds: Sequence[float], fraction: float) -> float:
    return bounds[0] + fraction * (bounds[1] - bounds[0])


def with_offset(start: Start, offsets: Floats, rng: np.random.Generator, blocked: Blocked) -> Start:
    """Return `start` moved to a free pose within `offsets`, or unchanged if none is found."""
    if not offsets.any():
        return start
    return (
        _first_free(lambda: replace(start, eta=start.eta + rng.uniform(-offsets, offsets)), blocked) or start
    )


def _first_free(draw: Callable[[], Start], blocked: Blocked) -> Start | None:
    """Return the first drawn start that is not blocked, or None after `MAX_DRAWS`."""
    for _ in range(MAX_DRAWS):
        start = draw()
        if not blocked(start.eta[None])[0]:
            return start
    return None
