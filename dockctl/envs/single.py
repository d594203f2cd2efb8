"""One boat as a Gymnasium environment: row 0 of a vector environment with one boat."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from dockctl.envs.info import Info
from dockctl.envs.vector import DockingVectorEnv, ScenarioSource
from dockctl.sim.world import World


class DockingEnv(gymnasium.Env[NDArray[np.float32], Any]):
    """Dock a small underactuated boat in reverse at a berth, without touching the harbor.

    ## Action space
    `Discrete(77)`: 11 propeller forces (-50 to 50 N) times 7 rudder angles (-30 to 30 degrees); action i is
    force i // 7 with angle i % 7. The command is held for the control period of 0.5 s. A scenario may define
    another grid, or ``actions: {kind: continuous}``: `Box(-1, 1, (2,))`, fractions of the maximum propeller
    force and rudder angle.

    ## Observation space
    `Box` of float32; values are clipped to the bounds. The scenario lists the parts: scenario 3 has the 16
    numbers of the table, scenarios 1 and 2 all but the phase.

    | part          | quantity                                   | divided by                   | low | high |
    |---------------|--------------------------------------------|------------------------------|-----|------|
    | phase         | 0 before the intermediate pose, 1 after it | 1                            | 0   | 1    |
    | distance      | to the goal of the phase                   | 10 m                         | 0   | 10   |
    | heading_error | heading minus the goal's, in (-pi, pi]     | 1 rad                        | -pi | pi   |
    | velocity      | surge, sway, yaw rate                      | 0.4 m/s, 0.1 m/s, 0.04 rad/s | -5  | 5    |
    | command       | last propeller force and rudder angle      | the vessel's limits          | -1  | 1    |
    | lidar         | nearest return of each of 8 sectors        | 10 m                         | 0   | 2    |

    Sector k of the LiDAR, k = 1...8, covers the bearings from 45 k - 225 to 45 k - 180 degrees,
    counterclockwise from the bow.

    ## Reward
    Equations 3.10 and 3.13 of the thesis with the scenario's weights: collision -30,000, final pose +30,000,
    intermediate pose +30,000 (scenario 3); in every other step the sum of -150 times the distance in units of
    20 m, -100 times the heading error [rad], and -20 (scenario 3: -10) times the speed [m/s] divided by that
    distance. `info["reward_terms"]` has the contribution of each term.

    ## Episode
    Starts at rest at one of the scenario's initial poses; `options={"poses": [[x_m, y_m, heading_rad]]}` sets
    the pose, and `exploring=True` draws starts as in training. Terminates at the final pose (distance < 1 m,
    heading error < 0.07 rad, speed <= 0.1 m/s) and on collision. Truncates after 500 steps, or the scenario's
    `task.max_steps`.

    ## Info
    `pose` and `goal` of the phase (x, y [m], heading [rad]), `velocity` over ground (u, v [m/s], r [rad/s]),
    `command` ([N], [rad]), `distance_m` and `heading_error_rad` to the goal, `phase`, `sector_ranges_m`,
    `outcome` ("" during the episode, then "docked", "collision" or "timeout"), `collided_with`,
    `reward_terms`, `start_kind` ("pose", "exploring" or "retried"), `start_index` of the initial pose.

    ## Version history
    - v0: first version.

    Args:
        scenario: name, path, or a loaded scenario.
        base_dir: folder that mesh paths of a `Scenario` object are relative to.
        exploring: draw starts as in training.
        render_mode: "rgb_array" for plan views, or None.
        worlds: harbors to use instead of building those of the scenario.

    Raises:
        DockctlError: the scenario is invalid.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        scenario: ScenarioSource,
        *,
        base_dir: Path | None = None,
        exploring: bool = False,
        render_mode: str | None = None,
        worlds: Sequence[World] | None = None,
    ) -> None:
        self.batch = DockingVectorEnv(
            scenario,
            base_dir=base_dir,
            exploring=exploring,
            render_mode=render_mode,
            autoreset_mode=AutoresetMode.DISABLED,
            worlds=worlds,
        )
        self.render_mode = render_mode
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """Start an episode; see `DockingVectorEnv.reset`."""
        super().reset(seed=seed)
        observations, info = self.batch.reset(seed=seed, options=options)
        return observations[0], _first(info)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, Info]:
        """Apply the action for one control period; see `DockingVectorEnv.step`."""
        observations, reward, terminated, truncated, info = self.batch.step(np.array([action]))
        return observations[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a plan view (height, width, 3), or None without a render mode."""
        frames = self.batch.render()
        return None if frames is None else frames[0]


def _first(info: Info) -> Info:
    return {key: _first(value) if isinstance(value, dict) else value[0] for key, value in info.items()}
