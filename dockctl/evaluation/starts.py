"""Start poses for validation, tests, plots and export.

`dockctl.sim.starts` draws a single start; this module selects sets of them.
"""

from __future__ import annotations

from collections.abc import Sequence

from dockctl.geometry import pose_array
from dockctl.scenarios.harbor import layouts
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import PoseCheck
from dockctl.sim.harbor.build import build_harbor
from dockctl.sim.starts import Blocked, Site, Start, free_sites, given_start, own_site, random_starts
from dockctl.sim.world import World

TRAINING = "training"
"""Kind of the starts at the initial poses of the training."""


def validation_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the starts of the greedy episodes during training, which select the best checkpoint.

    They are the evaluation poses, or the initial poses where the scenario has none. A task with berths has
    random starts at the trained berths, with the intermediate poses drawn as in training.
    """
    task, evaluation = scenario.task, scenario.evaluation
    if task.berths is None:
        site, poses = own_site(scenario), evaluation.poses or task.initial
        return [given_start(site, task, pose_array(pose), index) for index, pose in enumerate(poses)]
    trained = [site for site in _sites(scenario, worlds) if site.kind == "trained"]
    return random_starts(
        scenario,
        trained,
        _blocked(worlds),
        episodes=evaluation.trained_berths,
        seed=evaluation.random_starts.seed,
        kind="trained",
        spread=True,
    )


def testing_starts(scenario: Scenario, worlds: Sequence[World], episodes: int, seed: int) -> list[Start]:
    """Return random starts around the initial poses, at the held-out berths if the task has any."""
    sites = _sites(scenario, worlds)
    held_out = [site for site in sites if site.kind == "held_out"]
    kind = "held_out" if held_out else "random"
    return random_starts(
        scenario, held_out or sites, _blocked(worlds), episodes=episodes, seed=seed, kind=kind
    )


def trajectory_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the starts whose trajectories are stored and drawn.

    They are the validation starts. A task with berths has its initial poses at each free berth of the harbor
    that is drawn.
    """
    if scenario.task.berths is None:
        return validation_starts(scenario, worlds)
    drawn = own_site(scenario).harbor
    return [
        given_start(site, scenario.task, pose, index, site.kind)
        for site in _sites(scenario, worlds)
        if site.harbor == drawn
        for index, pose in enumerate(site.initial)
    ]


def training_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the initial poses of the training, at each trained berth if the task has berths."""
    return [
        given_start(site, scenario.task, pose, index, TRAINING)
        for site in _sites(scenario, worlds)
        if site.kind != "held_out"
        for index, pose in enumerate(site.initial)
    ]


def pose_check(loaded: LoadedScenario) -> PoseCheck:
    """Return the check of poses in the harbor in which the berth of the task is vacant."""
    scenario = loaded.scenario
    layout = layouts(scenario.harbor, scenario.task.berths)[own_site(scenario).harbor]
    return PoseCheck.of(scenario, build_harbor(layout.harbor, loaded.base_dir))


def _sites(scenario: Scenario, worlds: Sequence[World]) -> list[Site]:
    return free_sites(scenario, _blocked(worlds))


def _blocked(worlds: Sequence[World]) -> list[Blocked]:
    return [world.obstacles.blocked for world in worlds]
