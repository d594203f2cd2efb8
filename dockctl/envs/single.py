"""One boat as a Gymnasium environment: row 0 of a batch of one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from dockctl.envs.vector import DockingVectorEnv, Info, ScenarioSource
from dockctl.sim.world import World


class DockingEnv(gymnasium.Env[NDArray[np.float32], Any]):
    """A small underactuated boat is to come to rest at a berth, in reverse, without touching the harbor.

    ## Action space
    `Discrete(77)`: 11 propeller forces (-50 to 50 N) times 7 rudder angles (-30 to 30 degrees); action i is
    force i // 7 with angle i % 7. The command is held for the control period of 0.5 s. A scenario may define
    another grid, or ``actions: {kind: continuous}``: `Box(-1, 1, (2,))`, fractions of the greatest propeller
    force and rudder angle.

    ## Observation space
    `Box` of float32; values beyond the bounds are clipped. The scenario lists the parts: scenario 3 has the
    16 numbers of the table, scenarios 1 and 2 all but the phase.

    | part          | what                                       | divided by                   | low | high |
    |---------------|--------------------------------------------|------------------------------|-----|------|
    | phase         | 0 to the intermediate, 1 to the final pose | 1                            | 0   | 1    |
    | distance      | to the goal of the phase                   | 10 m                         | 0   | 10   |
    | heading_error | heading minus the goal's, in (-pi, pi]     | 1 rad                        | -pi | pi   |
    | velocity      | surge, sway, yaw rate                      | 0.4 m/s, 0.1 m/s, 0.04 rad/s | -5  | 5    |
    | command       | last propeller force and rudder angle      | the vessel's limits          | -1  | 1    |
    | lidar         | nearest return of each of 8 sectors        | 10 m                         | 0   | 2    |

    Sector k of the LiDAR, k = 1...8, looks at the bearings from 45 k - 225 to 45 k - 180 degrees, counted
    counter-clockwise from the bow.

    ## Reward
    Equations 3.10 and 3.13 of the thesis with the scenario's weights: collision -30,000, final pose +30,000,
    intermediate pose +30,000 (scenario 3); in every other step minus 150 times the distance in units of 20 m,
    100 times the heading error in radians, and 20 (scenario 3: 10) times the speed over that distance.
    `info["reward_terms"]` has the parts.

    ## Episode
    Begins at rest at one of the scenario's initial poses; `options={"poses": [[x_m, y_m, heading_rad]]}` puts
    it elsewhere, and `exploring=True` draws starts as in training. Terminates at the final pose (distance
    < 1 m, heading error < 0.07 rad, speed <= 0.1 m/s) and on contact. Is truncated after 500 steps, or as
    many as the scenario says.

    ## Info
    `pose` (x, y [m], heading [rad]), `velocity` (u, v [m/s], r [rad/s]), `command` ([N], [rad]), `distance_m`
    and `heading_error_rad` to the goal of the phase, `phase`, `sector_ranges_m`, `outcome` ("" while it goes
    on, then "docked", "collision" or "timeout"), `collided_with`, `reward_terms`, `start_kind` ("pose" or
    "exploring"), `start_index` of the initial pose.

    ## Version history
    - v0: first version.

    Args:
        scenario: name, path, or a scenario already loaded.
        base_dir: what the mesh paths of a bare `Scenario` are relative to.
        exploring: begin episodes as in training.
        render_mode: "rgb_array" for pictures of the harbor from above, or None.
        worlds: the harbors, instead of those that the scenario describes.

    Raises:
        DockctlError: the scenario is wrong.
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
        """Begin an episode; see `DockingVectorEnv.reset`."""
        super().reset(seed=seed)
        observations, info = self.batch.reset(seed=seed, options=options)
        return observations[0], _first(info)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, Info]:
        """Hold the action for one control period; see `DockingVectorEnv.step`."""
        observations, reward, terminated, truncated, info = self.batch.step(np.array([action]))
        return observations[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def render(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) of the harbor from above, None without a render mode."""
        frames = self.batch.render()
        return None if frames is None else frames[0]


def _first(info: Info) -> Info:
    return {key: _first(value) if isinstance(value, dict) else value[0] for key, value in info.items()}
