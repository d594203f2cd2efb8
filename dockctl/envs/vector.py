"""n boats docking side by side as a native Gymnasium vector environment: the only step logic there is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import error
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dockctl.envs.observation import View
from dockctl.envs.spaces import ObservationEncoder
from dockctl.errors import DockctlError, nearest
from dockctl.rewards.compose import RewardFunction
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import load_checked
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, StartSampler, free_sites, given_start, own_site
from dockctl.sim.status import Bools, Floats, Ints, StepStatus
from dockctl.sim.world import World, build_worlds

Observations = NDArray[np.float32]
Info = dict[str, Any]
OPTIONS = ("poses", "starts", "reset_mask")
ScenarioSource = LoadedScenario | Scenario | str | Path


class DockingVectorEnv(VectorEnv[Observations, NDArray[Any], NDArray[Any]]):
    """n boats that learn to dock, stepped together; `DockingEnv` tells of observations, actions and rewards.

    A boat whose episode ended begins the next one in the same step (`AutoresetMode.SAME_STEP`): its row of
    the observations and of `info` is the new episode's first. Its last observation is `info["final_obs"][i]`
    and its last info row i of `info["final_info"]`, where the masks `info["_final_obs"]` and
    `info["_final_info"]` hold. With `AutoresetMode.DISABLED` it waits for
    `reset(options={"reset_mask": ended})`.

    Each boat draws from its own generator, spawned from the seed: what happens to boat i depends on the seed,
    on i and on its actions, not on how many boats there are.

    Args:
        scenario: name, path, or a scenario already loaded.
        num_envs: how many boats.
        base_dir: what the mesh paths of a bare `Scenario` are relative to.
        exploring: begin episodes as in training, with the scenario's exploring starts.
        render_mode: "rgb_array" or None.
        autoreset_mode: `SAME_STEP` or `DISABLED`.
        worlds: the harbors, instead of those that the scenario describes.

    Raises:
        DockctlError: the scenario is wrong.
    """

    metadata: dict[str, Any] = {
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        scenario: ScenarioSource,
        num_envs: int = 1,
        *,
        base_dir: Path | None = None,
        exploring: bool = False,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        worlds: Sequence[World] | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise DockctlError(f"unknown render_mode '{render_mode}' (allowed: rgb_array, None)")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:
            raise DockctlError("autoreset_mode must be SameStep or Disabled")
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.scenario, directory = _resolve(scenario, base_dir)
        self.worlds = worlds or build_worlds(self.scenario, directory)
        self.simulator = Simulator(self.scenario, self.worlds, num_envs)
        self.reward = RewardFunction(self.scenario.reward)
        blocked = [world.obstacles.blocked for world in self.worlds]
        self._own = own_site(self.scenario)
        trained = [site for site in free_sites(self.scenario, blocked) if site.kind != "held_out"]
        self._sampler = StartSampler(self.scenario, trained, blocked, exploring=exploring)
        self._encoder = ObservationEncoder(self.scenario.observation, self.scenario.sensors.lidar.sectors)
        self.observation_names = self._encoder.names
        self.single_observation_space = self._encoder.space
        self.single_action_space = self.scenario.actions.space(self.scenario.vessel)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs: list[np.random.Generator] = []
        self._start_kind = np.full(num_envs, "", object)
        self._start_index = np.zeros(num_envs, np.int64)
        self._ended = np.ones(num_envs, bool)
        self._trails: list[list[Floats]] = [[] for _ in range(num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Info]:
        """Begin an episode in every row.

        Args:
            seed: one for all, from which each row's is spawned, or one a row; None lets the generators go on.
            options: `poses`: (n, 3) x [m], y [m] and heading [rad] at which the rows begin, at rest.
                `starts`: n starts (`dockctl.sim.starts.Start`), which say more: goals, phase, harbor.
                `reset_mask`: (n,) bool, the rows to reset; the others go on.

        Raises:
            DockctlError: a pose is not finite or lies in an obstacle, or an option has the wrong shape.
        """
        options = options or {}
        for name in options:
            if name not in OPTIONS:
                message = f"unknown option '{name}' (known: {', '.join(OPTIONS)})"
                raise DockctlError(message, code="unknown_key", suggestion=nearest(name, OPTIONS))
        self._reseed(seed)
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise DockctlError(f"options['reset_mask'] must be {self.num_envs} booleans, one of them true")
        rows = np.flatnonzero(mask)
        if "starts" in options:
            if len(options["starts"]) != self.num_envs:
                raise DockctlError(f"options['starts'] must be {self.num_envs} starts, one a boat")
            starts = [options["starts"][row] for row in rows]
        elif "poses" in options:
            starts = self._given(rows, np.asarray(options["poses"], float))
        else:
            starts = self._draw(rows)
        self._begin(rows, starts)
        return self._observe(), self._info(self._no_events())

    def step(self, actions: NDArray[Any]) -> tuple[Observations, Floats, Bools, Bools, Info]:
        """Hold each boat's action (n,) for one control period.

        Raises:
            gymnasium.error.ResetNeeded: an episode ended and nobody reset it.
            gymnasium.error.InvalidAction: an action outside of the action space.
        """
        if self._ended.any():
            raise error.ResetNeeded("an episode has ended or none has begun: call reset() first")
        status = self.simulator.step(self._commands(actions))
        reward, by_term = self.reward(status)
        terminated = status.collided | status.reached_final
        truncated = ~terminated & (self.simulator.steps >= self.simulator.max_steps)
        self._ended = terminated | truncated
        self._extend_trails()
        observations, info = self._observe(), self._info(self._events(status, truncated, by_term))
        if self._ended.any() and self.autoreset_mode == AutoresetMode.SAME_STEP:
            observations, info = self._restart(observations, info)
        return observations, reward, terminated, truncated, info

    def clearance(self) -> Floats:
        """Return the least distance (n,) [m] between each boat's hull and its harbor."""
        return self.simulator.in_harbors(lambda world, eta: world.obstacles.clearance(eta))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture (height, width, 3) of the harbor from above for each boat, if there is a mode."""
        if self.render_mode is None:
            return None
        from dockctl.envs.render import draw_frame

        scenes = [self.worlds[harbor].scene() for harbor in self.simulator.harbor.tolist()]
        boats = zip(scenes, self.simulator.eta, self.simulator.goal, self._trails, strict=True)
        return tuple(draw_frame(scene, eta, goal, np.array(trail)) for scene, eta, goal, trail in boats)

    def _reseed(self, seed: int | Sequence[int | None] | None) -> None:
        """Give every row its own generator; without a seed, rows keep the ones they have."""
        if isinstance(seed, Sequence):
            if len(seed) != self.num_envs:
                raise DockctlError(f"expected {self.num_envs} seeds, one a boat, got {len(seed)}")
            sources = [np.random.SeedSequence(one).spawn(1)[0] for one in seed]
        elif seed is not None or not self._rngs:
            sources = np.random.SeedSequence(seed).spawn(self.num_envs)
        else:
            return
        self._rngs = [np.random.default_rng(source) for source in sources]

    def _draw(self, rows: Ints) -> list[Start]:
        return [self._sampler.draw(self._rngs[row]) for row in rows]

    def _given(self, rows: Ints, poses: Floats) -> list[Start]:
        if poses.shape != (self.num_envs, 3) or not np.isfinite(poses).all():
            raise DockctlError(f"options['poses'] must be finite numbers of shape ({self.num_envs}, 3)")
        blocked = self.worlds[self._own.harbor].obstacles.blocked
        for x, y, heading in poses[rows][blocked(poses[rows])]:
            raise DockctlError(f"the start pose ({x:g}, {y:g}, {np.degrees(heading):g}°) lies in an obstacle")
        return [given_start(self._own, self.scenario.task, poses[row], int(row)) for row in rows]

    def _begin(self, rows: Ints, starts: Sequence[Start]) -> None:
        self.simulator.reset(rows, starts, [self._rngs[row] for row in rows])
        self._start_kind[rows] = [start.kind for start in starts]
        self._start_index[rows] = [start.index for start in starts]
        self._ended[rows] = False
        for row in rows:
            self._trails[row] = [self.simulator.eta[row].copy()]

    def _restart(self, observations: Observations, info: Info) -> tuple[Observations, Info]:
        """Begin the next episode of the rows that ended, and put their last observation and info aside."""
        ended = self._ended.copy()
        rows = np.flatnonzero(ended)
        final_obs = np.full(self.num_envs, None, object)
        for row in rows:
            final_obs[row] = observations[row]
        self._begin(rows, self._draw(rows))
        events = {key: info[key].copy() for key in ("outcome", "collided_with")}
        terms = info["reward_terms"].items()
        events["reward_terms"] = {name: np.where(ended, 0.0, value) for name, value in terms}
        events["outcome"][rows] = events["collided_with"][rows] = ""
        last = _masked({"final_obs": final_obs, "final_info": info}, ended)
        return self._observe(), {**self._info(events), **last}

    def _commands(self, actions: NDArray[Any]) -> Floats:
        """Return the commands (n, 2) [N, rad] of the actions."""
        chosen, dtype = np.asarray(actions), self.action_space.dtype
        if dtype is not None and np.can_cast(chosen.dtype, dtype, "same_kind"):
            chosen = chosen.astype(dtype)
        if not self.action_space.contains(chosen):
            raise error.InvalidAction(f"expected actions of {self.action_space}, got {actions}")
        return self.scenario.actions.commands(chosen, self.scenario.vessel)

    def _observe(self) -> Observations:
        return self._encoder(View.of(self.simulator, self.simulator.sector_ranges_m))

    def _info(self, events: Info) -> Info:
        """Return the state of every boat, copied, and what happened to it."""
        simulator = self.simulator
        return {
            "pose": simulator.eta.copy(),
            "velocity": simulator.nu.copy(),
            "command": simulator.command.copy(),
            "distance_m": simulator.distance_m.copy(),
            "heading_error_rad": simulator.heading_error_rad.copy(),
            "goal": simulator.goal.copy(),
            "phase": simulator.phase.copy(),
            "sector_ranges_m": simulator.sector_ranges_m.copy(),
            "start_kind": self._start_kind.copy(),
            "start_index": self._start_index.copy(),
            **events,
        }

    def _no_events(self) -> Info:
        nothing = np.full(self.num_envs, "", object)
        terms = {name: np.zeros(self.num_envs) for name in self.reward.names}
        return {"outcome": nothing, "collided_with": nothing.copy(), "reward_terms": terms}

    def _events(self, status: StepStatus, truncated: Bools, by_term: dict[str, Floats]) -> Info:
        events = self._no_events()
        events["reward_terms"] = by_term
        happened = {"collision": status.collided, "docked": status.reached_final, "timeout": truncated}
        for outcome, rows in happened.items():
            events["outcome"][rows] = outcome
        for row in np.flatnonzero(status.collided):
            world = self.worlds[int(self.simulator.harbor[row])]
            events["collided_with"][row] = world.obstacles.collided_part(self.simulator.eta[row]) or ""
        return events

    def _extend_trails(self) -> None:
        if self.render_mode is not None:
            for trail, eta in zip(self._trails, self.simulator.eta, strict=True):
                trail.append(eta.copy())


def _resolve(scenario: ScenarioSource, base_dir: Path | None) -> tuple[Scenario, Path]:
    if isinstance(scenario, Scenario):
        return scenario, base_dir or Path.cwd()
    loaded = scenario if isinstance(scenario, LoadedScenario) else load_checked(scenario)
    return loaded.scenario, loaded.base_dir


def _masked(info: Info, mask: Bools) -> Info:
    """Return `info` with a mask `_key` beside every key, as Gymnasium's vector environments give it."""
    masked: Info = {}
    for key, value in info.items():
        masked[key] = _masked(value, mask) if isinstance(value, dict) else value
        masked[f"_{key}"] = mask
    return masked
