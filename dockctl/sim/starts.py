"""Where episodes begin: at the initial poses, at random on the way, or at random around the initial poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dockctl.geometry import wrap
from dockctl.scenarios.schema import Scenario, Task
from dockctl.scenarios.training import ExploringStarts
from dockctl.sim.goal import TO_FINAL, TO_INTERMEDIATE
from dockctl.sim.sites import Site
from dockctl.sim.status import Bools, Floats

TRIES = 100
Blocked = Callable[[Floats], Bools]


@dataclass(frozen=True)
class Start:
    """How one episode begins.

    Attributes:
        eta: (3,) x, y [m] and heading [rad].
        nu: (3,) u, v [m/s] and r [rad/s].
        phase: 0 on the way to the intermediate pose, 1 on the way to the final pose.
        goals: (2, 3) intermediate and final pose; both the final pose where there is no intermediate.
        max_steps: control steps until the episode is cut.
        kind: "pose", "exploring", "random", "trained" or "held_out".
        index: of the initial pose, or of the given pose.
        harbor: index of the harbor in which the boat is.
        berth: name of the berth; empty where the task stays where it is written.
        seed: of what the conditions draw in this episode; None for the boat's own generator.
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


def given_start(site: Site, task: Task, pose: Floats, index: int, kind: str = "pose") -> Start:
    """Return a start at rest at `pose` (3,) [m, m, rad], in the first phase of the task."""
    eta, rest = np.asarray(pose, float), np.zeros(3)
    return Start(
        eta, rest, site.first_phase, site.goals, task.max_steps, kind, index, site.harbor, site.berth
    )


def initial_start(site: Site, task: Task, rng: np.random.Generator, blocked: Blocked) -> Start:
    """Draw one of the initial poses and its offset; an offset into an obstacle is drawn again."""
    index = int(rng.integers(len(site.initial)))
    initial = task.initial[index]
    start = given_start(site, task, site.initial[index], index)
    return _nearby(start, _reach(initial.position_offset_m, initial.heading_offset_deg), rng, blocked)


def exploring_start(
    site: Site, task: Task, exploring: ExploringStarts, rng: np.random.Generator, blocked: Blocked
) -> Start:
    """Draw a start on the way: a leg of the task, a place on its straight line, and noise of a drawn size.

    The heading turns along the leg by the shorter way round. Where nothing is free, it is an initial pose.
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
        way = end - begin
        way[2] = wrap(way[2])
        eta = begin + rng.random() * way
        size = rng.random()  # one draw for both: near misses are near in position and in heading
        reach = _reach(
            _between(exploring.position_noise_m, size), _between(exploring.heading_noise_deg, size)
        )
        surge = rng.uniform(-exploring.max_surge_mps, exploring.max_surge_mps)
        place = given_start(site, task, eta + rng.uniform(-reach, reach), index, "exploring")
        return replace(place, nu=np.array([surge, 0.0, 0.0]), phase=phase, max_steps=exploring.steps)

    return _first_free(draw, blocked) or initial_start(site, task, rng, blocked)


def spread_intermediate(site: Site, task: Task, rng: np.random.Generator, blocked: Blocked) -> Site:
    """Return the site with its intermediate pose drawn within the offsets that the task gives it."""
    pose = task.intermediate
    if pose is None or not (reach := _reach(pose.position_offset_m, pose.heading_offset_deg)).any():
        return site
    intermediate, final = site.goals
    gate = given_start(site, task, intermediate, 0)
    return replace(site, goals=np.stack([_nearby(gate, reach, rng, blocked).eta, final]))


class StartSampler:
    """Draws the starts of episodes at the sites of one scenario.

    Args:
        sites: where; one is drawn for each episode.
        blocked: for each harbor, tells of poses (n, 3) whether the boat would touch or lie in an obstacle.
        exploring: draw `training.exploring_starts` too, as in training; else only the initial poses.
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
        site = spread_intermediate(site, self._task, rng, blocked)
        if self._exploring is not None and rng.random() < self._exploring.fraction:
            return exploring_start(site, self._task, self._exploring, rng, blocked)
        return initial_start(site, self._task, rng, blocked)


def random_starts(
    scenario: Scenario,
    sites: Sequence[Site],
    blocked: Sequence[Blocked],
    *,
    episodes: int,
    seed: int,
    kind: str = "random",
    spread: bool = False,
) -> list[Start]:
    """Draw free starts around the initial poses of the sites, as `evaluation.random_starts` says.

    Start i does not depend on how many are drawn. A draw that finds nothing free is the initial pose itself.
    With `spread`, the intermediate pose is drawn as in training, too.
    """
    around, task = scenario.evaluation.random_starts, scenario.task
    reach = _reach(around.position_m, around.heading_deg)
    starts = []
    for child in np.random.SeedSequence(seed).spawn(episodes):
        rng = np.random.default_rng(child)
        site = sites[int(rng.integers(len(sites)))]
        if spread:
            site = spread_intermediate(site, task, rng, blocked[site.harbor])
        index = int(rng.integers(len(site.initial)))
        start = given_start(site, task, site.initial[index], index, kind)
        starts.append(_nearby(start, reach, rng, blocked[site.harbor]))
    return starts


def _reach(position_m: float, heading_deg: float) -> Floats:
    return np.array([position_m, position_m, np.radians(heading_deg)])


def _between(bounds: Sequence[float], fraction: float) -> float:
    return bounds[0] + fraction * (bounds[1] - bounds[0])


def _nearby(start: Start, reach: Floats, rng: np.random.Generator, blocked: Blocked) -> Start:
    """Return `start` moved by up to `reach` to a free pose, or unmoved where none is found."""
    if not reach.any():
        return start
    return _first_free(lambda: replace(start, eta=start.eta + rng.uniform(-reach, reach)), blocked) or start


def _first_free(draw: Callable[[], Start], blocked: Blocked) -> Start | None:
    """Return the first drawn start that is not blocked, or None after `TRIES`."""
    for _ in range(TRIES):
        start = draw()
        if not blocked(start.eta[None])[0]:
            return start
    return None
