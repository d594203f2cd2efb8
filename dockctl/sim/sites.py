"""Where a task is to be done: at the berth it is written for, or carried to many."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from dockctl.errors import InputError, Problem
from dockctl.geometry import pose_array, transfer_poses
from dockctl.scenarios.berths import BerthKind, BerthPlace, layouts
from dockctl.scenarios.harbor import Marina
from dockctl.scenarios.schema import Scenario, Task
from dockctl.sim.goal import TO_FINAL, TO_INTERMEDIATE, measure
from dockctl.sim.harbor.build import berth_pose
from dockctl.sim.status import Bools, Floats

SAME_POSE = 1e-3
"""Poses that differ by less [m, rad] are one."""


@dataclass(frozen=True, eq=False)
class Site:
    """The poses of a task at one berth.

    Attributes:
        initial: (k, 3) the initial poses, x, y [m] and heading [rad].
        goals: (2, 3) intermediate and final pose; both the final pose where there is no intermediate.
        first_phase: in which an episode begins.
        harbor: index of the harbor, among those of the scenario, in which the berth is free.
        kind: "trained" or "held_out"; empty where the task stays where it is written.
        berth: its name; empty where the task stays where it is written.
    """

    initial: Floats
    goals: Floats
    first_phase: int
    harbor: int = 0
    kind: str = ""
    berth: str = ""


def _written(task: Task) -> Site:
    """Return the task where it is written."""
    final = pose_array(task.final)
    intermediate = final if task.intermediate is None else pose_array(task.intermediate)
    phase = TO_FINAL if task.intermediate is None else TO_INTERMEDIATE
    return Site(np.stack([pose_array(pose) for pose in task.initial]), np.stack([intermediate, final]), phase)


def own_site(scenario: Scenario) -> Site:
    """Return the task where it is written, in the harbor in which its berth is free.

    Raises:
        InputError: the task is carried to berths, and its final pose is at none of them.
    """
    own, every = _written(scenario.task), sites(scenario)
    distance, turn = measure(np.stack([site.goals[1] for site in every]), own.goals[1:])
    there = np.flatnonzero((distance < SAME_POSE) & (np.abs(turn) < SAME_POSE))
    if not len(there):
        x, y, heading = every[int(distance.argmin())].goals[1]
        message = (
            "it is the pose of none of task.berths, so there is no harbor in which it is known to be free;"
            f" the nearest one is ({x:g}, {y:g}, {np.degrees(heading):g}°)"
        )
        raise _flaw(scenario, "task.final", message)
    return replace(own, harbor=every[there[0]].harbor)


def sites(scenario: Scenario) -> list[Site]:
    """Return every site of a scenario: the task where it is written, or each berth from one side or both."""
    own, berths = _written(scenario.task), scenario.task.berths
    if berths is None:
        return [own]
    assert isinstance(scenario.harbor, Marina)  # held by the scenario's validator
    return [
        _carried(own, berth_pose(scenario.harbor, place), mirrored, harbor, layout.kind or "", place)
        for harbor, layout in enumerate(layouts(scenario.harbor, berths))
        for place in layout.berths
        for mirrored in ((False, True) if berths.mirrored else (False,))
    ]


def free_sites(scenario: Scenario, blocked: Sequence[Callable[[Floats], Bools]]) -> list[Site]:
    """Return the sites whose poses are free; at the end of a quay one side of a berth may have no room.

    Args:
        blocked: for each harbor, tells of poses (n, 3) whether the boat would touch or lie in an obstacle.

    Raises:
        InputError: none of the trained, or of the held-out, berths is free.
    """
    every, berths = sites(scenario), scenario.task.berths
    if berths is None:
        return every
    free = [
        site for site in every if not blocked[site.harbor](np.concatenate([site.initial, site.goals])).any()
    ]
    for kind in get_args(BerthKind):
        if berths.places(kind) and not any(site.kind == kind for site in free):
            message = (
                "at each of these berths one of the task's poses lies in an obstacle; name one with room"
            )
            raise _flaw(scenario, f"task.berths.{kind}", message)
    return free


def _flaw(scenario: Scenario, field: str, message: str) -> InputError:
    return InputError([Problem(f"scenario '{scenario.name}'", 0, 0, field, message)])


def _carried(
    own: Site, to: tuple[float, float, float], mirrored: bool, harbor: int, kind: str, place: BerthPlace
) -> Site:
    final = own.goals[1]
    berth = f"{place.side} {place.at_m:g}{' mirrored' if mirrored else ''}"
    initial, goals = (
        transfer_poses(poses, final, np.array(to), mirrored) for poses in (own.initial, own.goals)
    )
    return Site(initial, goals, own.first_phase, harbor, kind, berth)
