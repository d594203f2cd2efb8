"""Start poses for validation, evaluation, plots and export.

`dockctl.sim.starts` draws a single start; this module selects sets of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dockctl.errors import DockctlError
from dockctl.geometry import pose_array
from dockctl.scenarios.base import Pose
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import PoseCheck
from dockctl.sim.harbor.build import Harbor, build_harbor
from dockctl.sim.starts import (
    Site,
    Start,
    draw_intermediate,
    free_sites,
    given_start,
    is_trained,
    offset_limits,
    own_site,
    sites,
    with_offset,
)
from dockctl.sim.world import World, unreachable_in

TRAINING = "training"
"""Kind of the starts at the training's initial poses."""


VALIDATION = "validation"
"""Kind of the starts that are used to select the best checkpoint."""


def evaluation_poses(scenario: Scenario) -> list[Start]:
    """Return starts at the evaluation poses, or at the initial poses if the scenario has none.

    A task with berths has none.
    """
    task = scenario.evaluated_task
    if task.berths is not None:
        return []
    site, poses = own_site(scenario), scenario.evaluation.poses or task.initial
    return [given_start(site, task, pose_array(pose), index) for index, pose in enumerate(poses)]


def evaluation_starts(scenario: Scenario, worlds: Sequence[World], seed: int | None = None) -> list[Start]:
    """Return the evaluation poses, or random starts at the trained berths of a task with berths.

    There, the intermediate poses are drawn as in training.

    Args:
        seed: of the random starts; the scenario's by default.

    Raises:
        DockctlError: no pose around an initial pose is reachable, or no berth is free.
    """
    if scenario.task.berths is None:
        return evaluation_poses(scenario)
    evaluation = scenario.evaluation
    return random_starts(
        scenario,
        _trained(scenario, worlds),
        worlds,
        episodes=evaluation.trained_berths,
        seed=evaluation.random_starts.seed if seed is None else seed,
        kind="trained",
        spread=True,
    )


def checked_starts(loaded: LoadedScenario, poses: Sequence[Pose]) -> list[Start]:
    """Return starts at poses that the user gave with ``--pose``.

    Raises:
        DockctlError: a pose is not free.
    """
    check = pose_check(loaded)
    if problems := [problem for pose in poses if (problem := check.problem(pose))]:
        raise DockctlError("\n".join(f"--pose: {problem}" for problem in problems))
    site, task = own_site(loaded.scenario), loaded.scenario.evaluated_task
    return [given_start(site, task, pose_array(pose), index) for index, pose in enumerate(poses)]


def validation_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the random starts that select the best checkpoint, at the trained berths if the task has any.

    They are drawn like test starts but with other random numbers, also for their conditions.

    Raises:
        DockctlError: no pose around an initial pose is reachable, or no berth is free.
    """
    seed, episodes = scenario.evaluation.random_starts.seed, scenario.training.validation.starts
    starts = random_starts(
        scenario,
        _trained(scenario, worlds),
        worlds,
        episodes=episodes,
        seed=(seed, 1),  # test starts have a seed of one number
        kind=VALIDATION,
        spread=True,
    )
    return [replace(start, seed=2**32 + number) for number, start in enumerate(starts)]


def testing_starts(scenario: Scenario, worlds: Sequence[World], episodes: int, seed: int) -> list[Start]:
    """Return random starts around the initial poses, at the held-out berths if the task has any.

    Raises:
        DockctlError: see `random_starts`, or no berth is free.
    """
    if not episodes:
        return []
    held_out = not all(map(is_trained, sites(scenario)))
    places = free_sites(scenario, unreachable_in(worlds), among=lambda site: is_trained(site) is not held_out)
    kind = "held_out" if held_out else "random"
    return random_starts(scenario, places, worlds, episodes=episodes, seed=seed, kind=kind)


def trajectory_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the starts whose trajectories are stored and drawn.

    They are the evaluation poses, or for a task with berths the initial poses at each free berth of the
    harbor that is drawn.

    Raises:
        DockctlError: no berth is free.
    """
    if scenario.task.berths is None:
        return evaluation_poses(scenario)
    drawn = own_site(scenario).harbor
    return [
        given_start(site, scenario.evaluated_task, pose, index, site.kind)
        for site in free_sites(scenario, unreachable_in(worlds), among=lambda site: site.harbor == drawn)
        for index, pose in enumerate(site.initial)
    ]


def training_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return starts at the initial poses, at each trained berth if the task has berths.

    Raises:
        DockctlError: no berth is free.
    """
    return [
        given_start(site, scenario.evaluated_task, pose, index, TRAINING)
        for site in _trained(scenario, worlds)
        for index, pose in enumerate(site.initial)
    ]


def pose_check(loaded: LoadedScenario) -> PoseCheck:
    """Return the pose check for the harbor in which the berth of the task is free.

    Raises:
        DockctlError: a mesh file cannot be read, or the final pose is not at a berth.
    """
    return PoseCheck.build(loaded.scenario, layout_harbor(loaded, own_site(loaded.scenario).harbor))


def layout_harbor(loaded: LoadedScenario, index: int) -> Harbor:
    """Return one of the harbors of a scenario, which `Start.harbor` numbers.

    Raises:
        DockctlError: a mesh file cannot be read.
    """
    every = layouts(loaded.scenario.harbor, loaded.scenario.task.berths)
    return build_harbor(every[index].harbor, loaded.base_dir)


def random_starts(
    scenario: Scenario,
    sites: Sequence[Site],
    worlds: Sequence[World],
    *,
    episodes: int,
    seed: int | tuple[int, ...],
    kind: str = "random",
    spread: bool = False,
) -> list[Start]:
    """Draw free starts around the initial poses of the sites, within `evaluation.random_starts`.

    Start i does not depend on the number of starts.

    Args:
        scenario: the scenario.
        sites: the sites; one is drawn per start.
        worlds: the harbors of the scenario.
        episodes: number of starts.
        seed: of the draws.
        kind: `Start.kind` of the starts.
        spread: also draw the intermediate pose, as in training.

    Raises:
        DockctlError: `episodes` or `seed` is negative, or no pose around an initial pose is reachable.
    """
    if episodes < 0 or min(np.atleast_1d(seed)) < 0:
        message = f"{episodes} episodes with seed {seed}: must not be negative"
        raise DockctlError(message, code="out_of_range")
    around, task = scenario.evaluation.random_starts, scenario.evaluated_task
    offsets = offset_limits(around.position_m, around.heading_deg)
    starts = []
    for child in np.random.SeedSequence(seed).spawn(episodes):
        rng = np.random.default_rng(child)
        site = sites[int(rng.integers(len(sites)))]
        unreachable = worlds[site.harbor].obstacles.unreachable
        if spread:
            site = draw_intermediate(site, task, rng, unreachable)
        index = int(rng.integers(len(site.initial)))
        start = given_start(site, task, site.initial[index], index, kind)
        starts.append(with_offset(start, offsets, rng, unreachable, "evaluation.random_starts"))
    return starts


def _trained(scenario: Scenario, worlds: Sequence[World]) -> list[Site]:
    return free_sites(scenario, unreachable_in(worlds), among=is_trained)
