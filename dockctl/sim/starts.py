"""Where episodes begin: at the initial poses, at random on the way, or at random around the initial poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dockctl.scenarios.base import Pose
from dockctl.scenarios.schema import Scenario, Task
from dockctl.scenarios.training import ExploringStarts
from dockctl.sim.goal import TO_FINAL, TO_INTERMEDIATE, wrap
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
        kind: "pose", "exploring" or "random".
        index: of the initial pose, or of the given pose.
    """

    eta: Floats
    nu: Floats
    phase: int
    goals: Floats
    max_steps: int
    kind: str
    index: int


def pose_array(pose: Pose) -> Floats:
    """Return x, y [m] and heading [rad], (3,)."""
    return np.array([pose.x_m, pose.y_m, np.radians(pose.heading_deg)])


def goal_poses(task: Task) -> Floats:
    """Return the intermediate and the final pose (2, 3) of a task."""
    final = pose_array(task.final)
    return np.stack([final if task.intermediate is None else pose_array(task.intermediate), final])


def given_start(task: Task, pose: Floats, index: int) -> Start:
    """Return a start at rest at `pose` (3,) [m, m, rad], in the first phase of the task."""
    phase = TO_FINAL if task.intermediate is None else TO_INTERMEDIATE
    return Start(np.asarray(pose, float), np.zeros(3), phase, goal_poses(task), task.max_steps, "pose", index)


def initial_start(task: Task, rng: np.random.Generator, blocked: Blocked) -> Start:
    """Draw one of the initial poses and its offset; an offset into an obstacle is drawn again."""
    index = int(rng.integers(len(task.initial)))
    initial = task.initial[index]
    start = given_start(task, pose_array(initial), index)
    reach = _reach(initial.position_offset_m, initial.heading_offset_deg)
    return _nearby(start, reach, rng, blocked) if reach.any() else start


def exploring_start(
    task: Task, exploring: ExploringStarts, rng: np.random.Generator, blocked: Blocked
) -> Start:
    """Draw a start on the way: a leg of the task, a place on its straight line, and noise of a drawn size.

    The heading turns along the leg by the shorter way round. Where nothing is free, it is an initial pose.
    """
    initial = given_start(task, pose_array(task.initial[0]), 0)

    def draw() -> Start:
        index = int(rng.integers(len(task.initial)))
        intermediate, final = initial.goals
        begin, end, phase = pose_array(task.initial[index]), final, TO_FINAL
        if task.intermediate is not None:
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
        return Start(
            eta + rng.uniform(-reach, reach),
            np.array([surge, 0.0, 0.0]),
            phase,
            initial.goals,
            exploring.steps,
            "exploring",
            index,
        )

    return _first_free(draw, blocked) or initial_start(task, rng, blocked)


class StartSampler:
    """Draws the episodes' starts of one scenario.

    Args:
        blocked: tells of poses (n, 3) whether the boat would touch or lie in an obstacle.
        exploring: draw `training.exploring_starts` too, as in training; else only the initial poses.
    """

    def __init__(self, scenario: Scenario, blocked: Blocked, *, exploring: bool = False) -> None:
        self._task = scenario.task
        self._exploring = scenario.training.exploring_starts if exploring else None
        self._blocked = blocked

    def draw(self, rng: np.random.Generator) -> Start:
        """Draw the start of one episode."""
        if self._exploring is not None and rng.random() < self._exploring.fraction:
            return exploring_start(self._task, self._exploring, rng, self._blocked)
        return initial_start(self._task, rng, self._blocked)


def random_poses(scenario: Scenario, blocked: Blocked, *, episodes: int, seed: int) -> Floats:
    """Draw free poses (episodes, 3) [m, m, rad] around the initial poses, as `evaluation.random_starts` says.

    Pose i does not depend on how many are drawn. A draw that finds nothing free is the initial pose itself.
    """
    around = scenario.evaluation.random_starts
    reach = _reach(around.position_m, around.heading_deg)
    poses = np.empty((episodes, 3))
    for row, child in enumerate(np.random.SeedSequence(seed).spawn(episodes)):
        rng = np.random.default_rng(child)
        index = int(rng.integers(len(scenario.task.initial)))
        start = given_start(scenario.task, pose_array(scenario.task.initial[index]), index)
        poses[row] = _nearby(start, reach, rng, blocked).eta
    return poses


def _reach(position_m: float, heading_deg: float) -> Floats:
    return np.array([position_m, position_m, np.radians(heading_deg)])


def _between(bounds: Sequence[float], fraction: float) -> float:
    return bounds[0] + fraction * (bounds[1] - bounds[0])


def _nearby(start: Start, reach: Floats, rng: np.random.Generator, blocked: Blocked) -> Start:
    """Return `start` moved by up to `reach` to a free pose, or unmoved where none is found."""
    return _first_free(lambda: replace(start, eta=start.eta + rng.uniform(-reach, reach)), blocked) or start


def _first_free(draw: Callable[[], Start], blocked: Blocked) -> Start | None:
    """Return the first drawn start that is not blocked, or None after `TRIES`."""
    for _ in range(TRIES):
        start = draw()
        if not blocked(start.eta[None])[0]:
            return start
    return None
