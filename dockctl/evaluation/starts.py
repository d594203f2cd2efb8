"""Greedy episodes of a policy: where they begin, how they are played, and their trajectories as a table."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dockctl.geometry import pose_array
from dockctl.runs.tables import TRAJECTORIES, Value, all_columns, to_csv

if TYPE_CHECKING:
    from dockctl.agents.policy import Policy
    from dockctl.evaluation.rollout import Episode
    from dockctl.scenarios.loader import LoadedScenario
    from dockctl.scenarios.schema import Scenario
    from dockctl.sim.checks import PoseCheck
    from dockctl.sim.starts import Start
    from dockctl.sim.world import World

BOATS_SIDE_BY_SIDE = 16


def judging_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the starts that judge a policy during training.

    They are the test poses, or the initial poses where none are given; where the task has berths, random
    starts at the trained ones, by way of intermediate poses as in training.
    """
    from dockctl.sim.starts import free_sites, given_start, own_site, random_starts

    task, evaluation = scenario.task, scenario.evaluation
    if task.berths is None:
        site, poses = own_site(scenario), evaluation.poses or task.initial
        return [given_start(site, task, pose_array(pose), index) for index, pose in enumerate(poses)]
    blocked = [world.obstacles.blocked for world in worlds]
    trained = [site for site in free_sites(scenario, blocked) if site.kind == "trained"]
    seed = evaluation.random_starts.seed
    count = evaluation.trained_berths
    return random_starts(scenario, trained, blocked, episodes=count, seed=seed, kind="trained", spread=True)


def shown_starts(scenario: Scenario, worlds: Sequence[World]) -> list[Start]:
    """Return the starts whose trajectories are kept and drawn.

    They are those that judge the policy; where the task has berths, its initial poses at the berths that are
    free in the harbor that is drawn.
    """
    from dockctl.sim.starts import free_sites, given_start, own_site

    if scenario.task.berths is None:
        return judging_starts(scenario, worlds)
    here = own_site(scenario).harbor
    sites = free_sites(scenario, [world.obstacles.blocked for world in worlds])
    return [
        given_start(site, scenario.task, pose, index, site.kind)
        for site in sites
        if site.harbor == here
        for index, pose in enumerate(site.initial)
    ]


def testing_starts(scenario: Scenario, worlds: Sequence[World], episodes: int, seed: int) -> list[Start]:
    """Return seeded random starts: around the initial poses, at the held-out berths where there are any."""
    from dockctl.sim.starts import free_sites, random_starts

    blocked = [world.obstacles.blocked for world in worlds]
    sites = free_sites(scenario, blocked)
    held_out = [site for site in sites if site.kind == "held_out"]
    kind = "held_out" if held_out else "random"
    return random_starts(scenario, held_out or sites, blocked, episodes=episodes, seed=seed, kind=kind)


def pose_check(loaded: LoadedScenario) -> PoseCheck:
    """Return the check of poses in the harbor that the task is written for."""
    from dockctl.scenarios.berths import layouts
    from dockctl.sim.checks import PoseCheck
    from dockctl.sim.harbor.build import build_harbor
    from dockctl.sim.starts import own_site

    scenario = loaded.scenario
    layout = layouts(scenario.harbor, scenario.task.berths)[own_site(scenario).harbor]
    return PoseCheck.of(scenario, build_harbor(layout.harbor, loaded.base_dir))


def player(
    loaded: LoadedScenario, worlds: Sequence[World], starts: Sequence[Start]
) -> Callable[[Policy], list[Episode]]:
    """Return a function that plays one episode from each start."""
    from dockctl.envs.vector import DockingVectorEnv
    from dockctl.evaluation.rollout import play
    from dockctl.sim.collision import hull_reach_m, least_clearance

    boats = min(BOATS_SIDE_BY_SIDE, max(1, len(starts)))
    env = DockingVectorEnv(loaded, boats, worlds=worlds)
    reach_m = hull_reach_m(loaded.scenario.vessel.hull)

    def clearance(start: Start, way: NDArray[np.float64]) -> float:
        return least_clearance(way, worlds[start.harbor].obstacles.clearance, reach_m)

    return lambda policy: play(env, policy, starts, clearance)


def trajectories_csv(episodes: Sequence[Episode], control_period_s: float) -> str:
    """Text of ``trajectories.csv``."""
    rows = list(_trajectory_rows(episodes, control_period_s))
    return to_csv(rows, all_columns(TRAJECTORIES, rows))


def _trajectory_rows(episodes: Sequence[Episode], control_period_s: float) -> Iterator[dict[str, Value]]:
    """One row a control step."""
    for pose, episode in enumerate(episodes):
        course = episode.course
        for step in range(episode.steps + 1):
            x, y, heading = course["pose"][step]
            u, v, r = course["velocity"][step]
            force, angle = course["command"][step]
            yield {
                "pose": pose,
                "step": step,
                "outcome": episode.outcome,
                "time_s": step * control_period_s,
                "x_m": x,
                "y_m": y,
                "heading_deg": math.degrees(heading),
                "u_mps": u,
                "v_mps": v,
                "r_degps": math.degrees(r),
                "propeller_n": force,
                "rudder_deg": math.degrees(angle),
                "distance_m": course["distance_m"][step],
                "heading_error_deg": math.degrees(course["heading_error_rad"][step]),
                "phase": int(course["phase"][step]),
                "reward": course["reward"][step],
                **{f"range_{i}_m": d for i, d in enumerate(course["sector_ranges_m"][step], start=1)},
            }
