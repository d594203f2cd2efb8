"""What ``train`` and ``evaluate`` build from a scenario: environments, evaluation starts, trajectories."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dockctl.runs.tables import Value

if TYPE_CHECKING:
    from dockctl.agents.evaluator import Episode
    from dockctl.agents.policy import Policy
    from dockctl.scenarios.loader import LoadedScenario
    from dockctl.scenarios.schema import Scenario
    from dockctl.sim.simulator import World

BOATS_SIDE_BY_SIDE = 16


def test_poses(scenario: Scenario) -> NDArray[np.float64]:
    """Return the poses (k, 3) [m, m, rad] that judge a policy: the initial ones where none are given."""
    poses = scenario.evaluation.poses or scenario.task.initial
    return np.array([(pose.x_m, pose.y_m, math.radians(pose.heading_deg)) for pose in poses])


def player(
    loaded: LoadedScenario, world: World, poses: NDArray[np.float64]
) -> Callable[[Policy], list[Episode]]:
    """Return a function that plays one episode from each pose."""
    from dockctl.agents.evaluator import play
    from dockctl.envs.vector import DockingVectorEnv
    from dockctl.sim.clearance import hull_reach_m, least_clearance

    boats = min(BOATS_SIDE_BY_SIDE, max(1, len(poses)))
    env = DockingVectorEnv(loaded, boats, world=world)
    reach_m = hull_reach_m(loaded.scenario.vessel.hull)

    def clearance(way: NDArray[np.float64]) -> float:
        return least_clearance(way, world.obstacles.clearance, reach_m)

    return lambda policy: play(env, policy, poses, clearance)


def trajectory_rows(episodes: Sequence[Episode], control_period_s: float) -> Iterator[dict[str, Value]]:
    """Rows of ``trajectories.csv``, one a control step."""
    for pose, episode in enumerate(episodes):
        course = episode.course
        for step in range(episode.steps + 1):
            x, y, heading = course["pose"][step]
            u, v, r = course["velocity"][step]
            force, angle = course["command"][step]
            yield {
                "pose": pose,
                "step": step,
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
