"""Start poses: the initial poses of the task at each berth, and exploring starts along its path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np

from dockctl.errors import DockctlError, InputError, Problem
from dockctl.geometry import Bools, Floats, pose_array, pose_label, relocate_poses, wrap
from dockctl.runs.tables import EXPLORING
from dockctl.scenarios.berths import BerthKind
from dockctl.scenarios.harbor import BerthPlace, Generated, Marina, berth_pose, docked_gap
from dockctl.scenarios.layouts import Layout, layouts
from dockctl.scenarios.schema import Scenario, Task
from dockctl.scenarios.training import ExploringStarts
from dockctl.sim.collision import collision_checker
from dockctl.sim.goal import TO_FINAL, TO_INTERMEDIATE, measure
from dockctl.sim.harbor.build import build_harbor

MAX_DRAWS = 1000
TRIAL_DRAWS = 200
CLOSE_DRAWS = 30
"""Attempts to draw a start near an obstacle; some initial poses have none nearby."""
UNREACHABLE = "are in an obstacle or not connected to the final pose by water"
SAME_POSE = 1e-3
"""Poses that differ by less [m, rad] are equal."""
Unreachable = Callable[[Floats, Floats], Bools]
"""Whether poses (n, 3) are blocked by an obstacle, or not connected to a goal (3,) by water, (n,)."""
Near = Callable[["Start", float], bool]
"""Whether an obstacle is within this distance [m] of the hull."""


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
        kind: "pose", "exploring", "retried", "random", "trained", "held_out", "training" or "validation".
        index: of the initial pose, or of the given pose.
        harbor: index of the harbor that the boat is in.
        berth: name of the berth; empty if the task is not relocated to berths.
        seed: of the random values of the conditions in this episode; None uses the generator of the boat.
        rejected: unreachable poses that were drawn before this one.
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
    rejected: int = 0


def own_site(scenario: Scenario) -> Site:
    """Return the task at the scenario's own poses, in the harbor in which its berth is free.

    Of generated layouts, which all have this berth, it is the first in which none of the poses is blocked.

    Raises:
        InputError: the task is relocated to berths, and its final pose is not the pose of one of them.
    """
    own, every = _task_site(scenario.task), sites(scenario)
    distance, turn = measure(np.stack([site.goals[1] for site in every]), own.goals[1:])
    same = np.flatnonzero((distance < SAME_POSE) & (np.abs(turn) < SAME_POSE))
    if not len(same):
        x, y, heading = every[int(distance.argmin())].goals[1].tolist()
        nearest = pose_label(x, y, math.degrees(heading))
        message = f"is not at any berth in task.berths; the nearest berth has {nearest}"
        raise _error(scenario, "task.final", message)
    harbors = list(dict.fromkeys(every[index].harbor for index in same))
    return replace(own, harbor=_first_free(scenario, own, harbors) if len(harbors) > 1 else harbors[0])


def _first_free(scenario: Scenario, site: Site, harbors: Sequence[int]) -> int:
    """Return the first generated layout in which the poses of a site are free, or just the first."""
    every = layouts(scenario.harbor, scenario.task.berths)
    poses = np.concatenate([site.initial, site.goals])
    for harbor in harbors:
        built = build_harbor(every[harbor].harbor, Path())  # generated layouts have no files
        if not collision_checker(built, scenario.vessel.hull).unreachable(poses, site.goals[1]).any():
            return harbor
    return harbors[0]


def sites(scenario: Scenario) -> list[Site]:
    """Return every site: the task itself, or each berth with the approach from one side or from both."""
    own, berths = _task_site(scenario.task), scenario.task.berths
    if berths is None:
        return [own]
    every, generated = layouts(scenario.harbor, berths), isinstance(scenario.harbor, Generated)
    marinas = [(layout.harbor, layout) for layout in every if isinstance(layout.harbor, Marina)]
    places = [(marina, place) for marina, layout in marinas for place in layout.berths]
    gap_m = docked_gap(places, own.goals[1], scenario.vessel.hull.length_m)
    return [
        _relocated(own, layout, place, gap_m, mirrored, harbor, generated)
        for harbor, layout in enumerate(every)
        for place in layout.berths
        for mirrored in ((False, True) if berths.mirrored else (False,))
    ]


def is_trained(site: Site) -> bool:
    """Return whether training may use the site."""
    return site.kind != "held_out"


def free_sites(
    scenario: Scenario,
    unreachable: Sequence[Unreachable],
    *,
    among: Callable[[Site], bool] = lambda site: True,
) -> list[Site]:
    """Return the sites whose poses are free: near the end of a quay, one side of a berth may be too narrow.

    Args:
        scenario: the scenario.
        unreachable: for each harbor.
        among: whether a site is wanted; only harbors with such sites are checked.

    Raises:
        InputError: none of the trained berths, or none of the held-out berths, is free.
    """
    every, berths = list(filter(among, sites(scenario))), scenario.task.berths
    if berths is None:
        return every
    free = [
        site
        for site in every
        if not unreachable[site.harbor](np.concatenate([site.initial, site.goals]), site.goals[1]).any()
    ]
    for kind in get_args(BerthKind):
        if any(site.kind == kind for site in every) and not any(site.kind == kind for site in free):
            field, advice = f"task.berths.{kind}", "name a berth with more space"
            if isinstance(scenario.harbor, Generated):
                field = "harbor.layouts" if kind == "trained" else "harbor.held_out_layouts"
                advice = "use more layouts, other seeds or wider fairways"
            message = f"at each of these berths a pose of the task is blocked; {advice}"
            raise _error(scenario, field, message)
    return free


def _task_site(task: Task) -> Site:
    final = pose_array(task.final)
    intermediate = final if task.intermediate is None else pose_array(task.intermediate)
    phase = TO_FINAL if task.intermediate is None else TO_INTERMEDIATE
    return Site(np.stack([pose_array(pose) for pose in task.initial]), np.stack([intermediate, final]), phase)


def _relocated(
    own: Site,
    layout: Layout,
    place: BerthPlace,
    gap_m: float,
    mirrored: bool,
    harbor: int,
    generated: bool,
) -> Site:
    assert isinstance(layout.harbor, Marina)  # checked by the validator of the scenario
    final, target = own.goals[1], np.array(berth_pose(layout.harbor, place, gap_m))
    berth = f"{place}{' mirrored' if mirrored else ''}"
    name = f"{layout.harbor.name} {berth}" if generated else berth
    initial, goals = (relocate_poses(poses, final, target, mirrored) for poses in (own.initial, own.goals))
    return Site(initial, goals, own.first_phase, harbor, layout.kind or "", name)


def _error(scenario: Scenario, field: str, message: str) -> InputError:
    return InputError([Problem(f"scenario '{scenario.name}'", 0, 0, field, message, "mismatch")])


def given_start(site: Site, task: Task, pose: Floats, index: int, kind: str = "pose") -> Start:
    """Return a start at rest at `pose` (3,) [m, m, rad], in the first phase of the task."""
    eta, rest = np.asarray(pose, float), np.zeros(3)
    return Start(
        eta, rest, site.first_phase, site.goals, task.max_steps, kind, index, site.harbor, site.berth
    )


def initial_start(site: Site, task: Task, rng: np.random.Generator, unreachable: Unreachable) -> Start:
    """Draw one of the initial poses and its offset; unreachable poses are drawn again.

    Raises:
        DockctlError: none is reachable.
    """
    index = int(rng.integers(len(site.initial)))
    initial = task.initial[index]
    start = given_start(site, task, site.initial[index], index)
    limits = offset_limits(initial.position_offset_m, initial.heading_offset_deg)
    return with_offset(start, limits, rng, unreachable, f"task.initial.{index}")


def exploring_start(
    site: Site, task: Task, exploring: ExploringStarts, rng: np.random.Generator, unreachable: Unreachable
) -> Start:
    """Draw an exploring start; unreachable ones are drawn again."""
    return _first_reachable(
        lambda: _exploring_draw(site, task, exploring, rng), unreachable, "training.exploring_starts"
    )


def _exploring_draw(site: Site, task: Task, exploring: ExploringStarts, rng: np.random.Generator) -> Start:
    """Draw a random point on a random leg of the task, with noise of a random size.

    The heading turns along the leg by the smaller angle.
    """
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
    size = rng.random()  # one draw for both: small position noise goes with small heading noise
    offsets = offset_limits(
        _interpolate(exploring.position_noise_m, size), _interpolate(exploring.heading_noise_deg, size)
    )
    surge = rng.uniform(-exploring.max_surge_mps, exploring.max_surge_mps)
    start = given_start(site, task, eta + rng.uniform(-offsets, offsets), index, EXPLORING)
    return replace(start, nu=np.array([surge, 0.0, 0.0]), phase=phase, max_steps=exploring.steps)


def draw_intermediate(site: Site, task: Task, rng: np.random.Generator, unreachable: Unreachable) -> Site:
    """Return the site with its intermediate pose drawn within the task's offsets.

    Raises:
        DockctlError: none is reachable.
    """
    pose = task.intermediate
    if pose is None or not (offsets := offset_limits(pose.position_offset_m, pose.heading_offset_deg)).any():
        return site
    intermediate, final = site.goals
    nominal = given_start(site, task, intermediate, 0)
    drawn = with_offset(nominal, offsets, rng, unreachable, "task.intermediate")
    return replace(site, goals=np.stack([drawn.eta, final]))


class StartSampler:
    """Draws the starts of episodes at the sites of one scenario.

    Args:
        scenario: the scenario.
        sites: the sites; one is drawn per episode.
        unreachable: for each harbor.
        near: needed for `training.close_starts`.
        exploring: draw as in training, with exploring starts and close starts; otherwise only initial poses.
    """

    def __init__(
        self,
        scenario: Scenario,
        sites: Sequence[Site],
        unreachable: Sequence[Unreachable],
        near: Near = lambda start, within_m: False,
        *,
        exploring: bool = False,
    ) -> None:
        self._task, self._sites, self._unreachable, self._near = scenario.task, sites, unreachable, near
        self._exploring = scenario.training.exploring_starts if exploring else None
        self._close = scenario.training.close_starts if exploring else None

    def draw(self, rng: np.random.Generator) -> Start:
        """Draw the start of one episode.

        Raises:
            DockctlError: none is reachable.
        """
        site = self._sites[int(rng.integers(len(self._sites)))]
        unreachable = self._unreachable[site.harbor]
        site = draw_intermediate(site, self._task, rng, unreachable)
        if self._exploring is not None and rng.random() < self._exploring.fraction:
            return exploring_start(site, self._task, self._exploring, rng, unreachable)
        start = initial_start(site, self._task, rng, unreachable)
        if self._close is not None and rng.random() < self._close.fraction:
            for _ in range(CLOSE_DRAWS):
                if self._near(start, self._close.within_m):
                    break
                start = initial_start(site, self._task, rng, unreachable)
        return start


def offset_limits(position_m: float, heading_deg: float) -> Floats:
    """Return the largest offsets (3,) in x, y [m] and heading [rad]."""
    return np.array([position_m, position_m, np.radians(heading_deg)])


def _interpolate(bounds: Sequence[float], fraction: float) -> float:
    return bounds[0] + fraction * (bounds[1] - bounds[0])


def with_offset(
    start: Start, offsets: Floats, rng: np.random.Generator, unreachable: Unreachable, field: str
) -> Start:
    """Return `start` moved within `offsets` (3,) to a reachable pose; `field` of the scenario gives them.

    Raises:
        DockctlError: none is reachable.
    """
    if not offsets.any():
        return start
    return _first_reachable(
        lambda: replace(start, eta=start.eta + rng.uniform(-offsets, offsets)), unreachable, field
    )


def _first_reachable(draw: Callable[[], Start], unreachable: Unreachable, field: str) -> Start:
    for rejected in range(MAX_DRAWS):
        start = draw()
        if not unreachable(start.eta[None], start.goals[1])[0]:
            return replace(start, rejected=rejected) if rejected else start
    where = f" at the berth {start.berth}" if start.berth else ""
    raise DockctlError(f"{field}: all of {MAX_DRAWS} poses drawn{where} {UNREACHABLE}; reduce the offsets")


def blocked_berths(scenario: Scenario, free: Sequence[Site]) -> dict[str, list[str]]:
    """Return the names of the berths without a site among `free`, by the field that lists them."""
    names: dict[str, list[str]] = {}
    with_site = {(site.harbor, *site.goals[1]) for site in free}
    for site in sites(scenario):
        if (berth := (site.harbor, *site.goals[1])) not in with_site:
            with_site.add(berth)  # each berth is named once, not once for each side
            names.setdefault(f"task.berths.{site.kind}", []).append(site.berth)
    return names


def rejected_shares(
    scenario: Scenario, unreachable: Sequence[Unreachable], every: Sequence[Site]
) -> dict[str, float]:
    """Return the fraction of trial draws at these sites that are unreachable, by the field of the offsets."""
    task, random, rng = scenario.task, scenario.evaluation.random_starts, np.random.default_rng(0)
    draws: dict[str, Callable[[Site], Start]] = {}

    def add(field: str, poses: slice, position_m: float, heading_deg: float) -> None:
        """Add the draws around initial poses and goals of a site, in this order."""
        limits = offset_limits(position_m, heading_deg)

        def draw(site: Site) -> Start:
            nominal = rng.choice(np.concatenate([site.initial, site.goals])[poses])
            return given_start(site, task, nominal + rng.uniform(-limits, limits), 0)

        if limits.any():
            draws[field] = draw

    count = len(task.initial)
    for index, pose in enumerate([*task.initial, *filter(None, [task.intermediate])]):
        field = f"task.initial.{index}" if index < count else "task.intermediate"
        add(field, slice(index, index + 1), pose.position_offset_m, pose.heading_offset_deg)
    if random.episodes:
        add("evaluation.random_starts", slice(count), random.position_m, random.heading_deg)
    if (exploring := scenario.training.exploring_starts) is not None:
        draws["training.exploring_starts"] = lambda site: _exploring_draw(site, task, exploring, rng)

    def share(draw: Callable[[Site], Start]) -> float:
        starts = [draw(every[i % len(every)]) for i in range(max(TRIAL_DRAWS, len(every)))]
        groups: dict[tuple[int, tuple[float, ...]], list[Floats]] = {}
        for start in starts:
            groups.setdefault((start.harbor, tuple(start.goals[1])), []).append(start.eta)
        rejected = (
            unreachable[harbor](np.array(poses), np.array(goal)).sum()
            for (harbor, goal), poses in groups.items()
        )
        return float(sum(rejected) / len(starts))

    return {field: share(draw) for field, draw in draws.items()}
