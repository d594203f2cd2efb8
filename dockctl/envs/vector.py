"""Gymnasium vector environment with n boats; the single environment is row 0 of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import error
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dockctl.envs.info import Info, events_of, masked, no_events, of_boats, of_conditions, without
from dockctl.envs.observation import BY_BOAT, ObservationEncoder, View
from dockctl.envs.state import Arrays, pack, unpack
from dockctl.errors import DockctlError, nearest, require_shape
from dockctl.geometry import Bools, Floats, Ints, pose_label
from dockctl.plugins import ACTIONS, Guard
from dockctl.rewards.compose import RewardFunction
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import load_checked
from dockctl.sim.retries import FailedStarts
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, StartSampler, free_sites, given_start, is_trained, own_site
from dockctl.sim.world import World, build_worlds, near_in, unreachable_in

Observations = NDArray[np.float32]
OPTIONS = ("poses", "starts", "reset_mask")
ScenarioSource = LoadedScenario | Scenario | str | Path


class DockingVectorEnv(VectorEnv[Observations, NDArray[Any], NDArray[Any]]):
    """n boats, stepped together; see `DockingEnv` for observations, actions, rewards and `info`.

    With `AutoresetMode.SAME_STEP`, a boat whose episode ends starts the next one in the same step: its rows
    of the observations and of `info` are the first of the new episode. The final observation of row i is
    `info["final_obs"][i]`, and its final info is row i of `info["final_info"]`, where the masks
    `info["_final_obs"]` and `info["_final_info"]` are true. With `AutoresetMode.NEXT_STEP`, the step after
    the last one only starts the next episode: it ignores the boat's action, and its reward is 0. With
    `AutoresetMode.DISABLED`, call `reset(options={"reset_mask": ended})`.

    Each boat draws from its own generator, spawned from the seed: the episodes of boat i depend on the seed,
    on i and on its actions, but not on the number of boats.

    It can be copied and pickled; copies in one process share the harbors.

    Args:
        scenario: name, path, or a loaded scenario.
        num_envs: number of boats.
        base_dir: folder that mesh paths of a `Scenario` object are relative to.
        exploring: draw starts as in training, with the scenario's exploring starts.
        render_mode: "rgb_array" or None.
        autoreset_mode: `SAME_STEP`, `NEXT_STEP` or `DISABLED`.
        worlds: harbors to use instead of building those of the scenario.
        device: "cpu", or "cuda" to simulate on an NVIDIA GPU.

    Raises:
        DockctlError: the scenario or an argument is invalid, or the device is not available.
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
        device: str = "cpu",
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            message = f"unknown render_mode '{render_mode}' (known: rgb_array, None)"
            raise DockctlError(message, code="unknown_name")
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            raise DockctlError(str(error), code="unknown_name") from None
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.scenario, directory = _resolve(scenario, base_dir)
        self.worlds = worlds or build_worlds(self.scenario, directory)
        self.simulator = Simulator(self.scenario, self.worlds, num_envs, device)
        self.reward = RewardFunction(self.scenario.reward)
        self._own = own_site(self.scenario)
        self._exploring = exploring
        self._encoder = ObservationEncoder(self.scenario.observation, self.scenario.sensors.lidar.sectors)
        self._past: tuple[View, ...] = ()
        self.observation_names, self.observation_parts = self._encoder.names, self._encoder.parts
        self.single_observation_space = self._encoder.space
        with Guard(ACTIONS, self.scenario.actions.kind):
            self.single_action_space = self.scenario.actions.space(self.scenario.vessel)
            self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._rngs: list[np.random.Generator] = []
        retried = self.scenario.training.retried_starts if exploring else None
        self._failed = FailedStarts(num_envs, 0.0 if retried is None else retried.fraction)
        self._start_kind = np.full(num_envs, "", object)
        self._start_index = np.zeros(num_envs, np.int64)
        self._ended = np.ones(num_envs, bool)
        self._trails: list[list[Floats]] = [[] for _ in range(num_envs)]

    @cached_property
    def _sampler(self) -> StartSampler:
        """Draws the starts that are not given; built on first use, since it needs all trained harbors."""
        unreachable = unreachable_in(self.worlds)
        trained = free_sites(self.scenario, unreachable, among=is_trained)
        return StartSampler(
            self.scenario, trained, unreachable, near_in(self.worlds), exploring=self._exploring
        )

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_sampler"}

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, Info]:
        """Start an episode in every row.

        Args:
            seed: one seed, from which a seed for each row is spawned, or n seeds; None for no reseeding.
            options: `poses`: (n, 3) start poses x [m], y [m] and heading [rad], at rest.
                `starts`: n `dockctl.sim.starts.Start`, which also define goals, phase and harbor, or None for
                boats that rest: until they are reset, steps do not change them, and their reward is 0.
                `reset_mask`: (n,) bool, the rows to reset; the others continue.

        Returns:
            Observations (n, k) float32 and `info`, arrays of n rows.

        Raises:
            DockctlError: a pose is not finite, is in an obstacle or is not connected to the final pose by
                water; no start can be drawn; or an option is unknown or has the wrong shape.
        """
        options = options or {}
        for name in options:
            if name not in OPTIONS:
                message = f"unknown option '{name}' (known: {', '.join(OPTIONS)})"
                raise DockctlError(message, code="unknown_key", suggestion=nearest(name, OPTIONS))
        self._reseed(seed)
        mask = np.asarray(options.get("reset_mask", np.ones(self.num_envs, bool)))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            message = f"options['reset_mask'] must be {self.num_envs} booleans, at least one of them true"
            raise DockctlError(message, code="mismatch")
        rows = np.flatnonzero(mask)
        if "starts" in options or "poses" in options:
            given = self._given(rows, options)
            resting = np.array([start is None for start in given])
            self.simulator.rest(rows[resting])
            self._ended[rows[resting]] = False
            rows, starts = rows[~resting], [start for start in given if start is not None]
            self._require_reachable(starts)
        else:
            starts = self._draw(rows)
        self._begin(rows, starts)
        return self._observe(), self._info(no_events(self.num_envs, self.reward.names))

    def step(self, actions: NDArray[Any]) -> tuple[Observations, Floats, Bools, Bools, Info]:
        """Apply each boat's action for one control period.

        Args:
            actions: n actions of the action space.

        Returns:
            Observations (n, k) float32, rewards (n,), terminated (n,), truncated (n,) and `info`.

        Raises:
            gymnasium.error.ResetNeeded: an episode has ended and was not reset.
            gymnasium.error.InvalidAction: an action is not in the action space.
        """
        if self._ended.any() and (self.autoreset_mode != AutoresetMode.NEXT_STEP or not self._rngs):
            raise error.ResetNeeded("an episode has ended or none has started: call reset() first")
        over = self._ended | self.simulator.resting
        commands = self._commands(actions)
        if self._past:
            self._past = (self._view().copy(), *self._past[:-1])
        status = self.simulator.step(commands)
        reward, by_term = self.reward(status)
        terminated = status.terminated & ~over
        truncated = ~over & ~terminated & (self.simulator.steps >= self.simulator.max_steps)
        self._ended = terminated | truncated
        self._failed.end(self._ended & ~status.reached_final)
        self._extend_trails()
        events = events_of(status, truncated, by_term, self.simulator)
        if over.any():
            reward, events = np.where(over, 0.0, reward), without(events, over)
            self._restart(over & ~self.simulator.resting)
        observations, info = self._observe(), self._info(events)
        if self._ended.any() and self.autoreset_mode == AutoresetMode.SAME_STEP:
            ended, final_obs = self._ended.copy(), np.full(self.num_envs, None, object)
            for row in np.flatnonzero(ended):
                final_obs[row] = observations[row]
            final = masked({"final_obs": final_obs, "final_info": info}, ended)
            self._restart(ended)
            events = without(events, ended)
            observations, info = self._observe(), {**self._info(events), **final}
        return observations, reward, terminated, truncated, info

    def state(self) -> tuple[Arrays, Info]:
        """Return the state of every boat in its episode, and of all generators, as arrays and JSON.

        An environment with the same scenario and number of boats continues from it, bit for bit. Only the
        paths that `render` draws are not included.

        Raises:
            DockctlError: a condition has a state that cannot be saved.
        """
        arrays: Arrays = {}
        own = {
            "simulator": self.simulator.state(),
            "generators": self._rngs,
            "start_kind": self._start_kind.tolist(),
            "start_index": self._start_index,
            "ended": self._ended,
            **({"past": [_by_boat(view) for view in self._past]} if self._past else {}),
            "failed": self._failed.state(),
        }
        try:
            return arrays, {key: pack(value, key, arrays) for key, value in own.items()}
        except TypeError as error:
            names = list(self.scenario.conditions)
            message = f"{error}, which cannot be saved; its condition must define state() and restore()"
            raise DockctlError(f"{message} (conditions: {', '.join(names)})", code="plugin") from None

    def restore(self, arrays: Arrays, facts: Info) -> tuple[Observations, Info]:
        """Continue from what `state` returned; the result is that of `reset`, for the restored boats.

        Raises:
            DockctlError: it is not a state of this scenario with this number of boats.
        """
        try:
            own = {key: unpack(value, arrays) for key, value in facts.items()}
            kinds, indices, ended = own["start_kind"], own["start_index"], own["ended"]
            rngs = own["generators"]
            if not {self.num_envs} == {len(kinds), len(indices), len(ended), len(rngs) or self.num_envs}:
                raise ValueError("a different number of boats")
            if ended.dtype != bool or (ended.any() and self.autoreset_mode == AutoresetMode.SAME_STEP):
                raise ValueError(f"'ended' is {ended.tolist()}")  # a new episode starts in the same step
            self.simulator.restore(own["simulator"])
            self._failed.restore(own.get("failed"))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            message = f"not a state of '{self.scenario.name}' with {self.num_envs} boats: {error}"
            raise DockctlError(message, code="mismatch") from None
        self._rngs, self._ended = rngs, ended
        self._past = tuple(replace(self._view(), past=(), **view) for view in own.get("past", ()))
        self._start_kind[:], self._start_index[:] = kinds, indices
        self._trails = [[eta.copy()] for eta in self.simulator.eta]
        return self._observe(), self._info(no_events(self.num_envs, self.reward.names))

    def observe(self, sector_ranges_m: Floats) -> Observations:
        """Return the observations (n, k) of the boats where they are, with these ranges (n, sectors) [m]."""
        return self._encoder(View.of(self.simulator, sector_ranges_m, self._past))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a plan view (height, width, 3) for each boat, or None without a render mode."""
        if self.render_mode is None:
            return None
        from dockctl.envs.render import draw_frame

        scenes = [self.worlds[harbor].scene() for harbor in self.simulator.harbor.tolist()]
        boats = zip(scenes, self.simulator.eta, self.simulator.goal, self._trails, strict=True)
        return tuple(draw_frame(scene, eta, goal, np.array(trail)) for scene, eta, goal, trail in boats)

    def _reseed(self, seed: int | Sequence[int | None] | None) -> None:
        """Create a generator for each row; without a seed, continue the existing generators."""
        if isinstance(seed, Sequence):
            if len(seed) != self.num_envs:
                message = f"expected {self.num_envs} seeds, one per boat, got {len(seed)}"
                raise DockctlError(message, code="mismatch")
            sources = [np.random.SeedSequence(row_seed).spawn(1)[0] for row_seed in seed]
        elif seed is not None or not self._rngs:
            sources = np.random.SeedSequence(seed).spawn(self.num_envs)
        else:
            return
        self._rngs = [np.random.default_rng(source) for source in sources]

    def _draw(self, rows: Ints) -> list[Start]:
        return [self._next_start(row, self._rngs[row]) for row in rows]

    def _next_start(self, row: int, rng: np.random.Generator) -> Start:
        return self._failed.take(row, rng) or self._sampler.draw(rng)

    def _given(self, rows: Ints, options: dict[str, Any]) -> list[Start | None]:
        """Return the starts of these rows (k,) from the options."""
        if "starts" in options:
            if len(options["starts"]) != self.num_envs:
                message = f"options['starts'] must be {self.num_envs} starts, one per boat"
                raise DockctlError(message, code="mismatch")
            return [options["starts"][row] for row in rows]
        poses = np.asarray(options["poses"], float)
        if poses.shape != (self.num_envs, 3) or not np.isfinite(poses).all():
            message = f"options['poses'] must be finite numbers of shape ({self.num_envs}, 3)"
            raise DockctlError(message, code="mismatch")
        return [given_start(self._own, self.scenario.task, poses[row], int(row)) for row in rows]

    def _require_reachable(self, starts: Sequence[Start]) -> None:
        for start in starts:
            obstacles, (x, y, heading) = self.worlds[start.harbor].obstacles, start.eta.tolist()
            if obstacles.unreachable(start.eta[None], start.goals[1])[0]:
                blocked = obstacles.blocked(start.eta[None])[0]
                reason = "in an obstacle" if blocked else "not connected to the final pose by water"
                raise DockctlError(f"the start pose {pose_label(x, y, math.degrees(heading))} is {reason}")

    def _begin(self, rows: Ints, starts: Sequence[Start]) -> None:
        if not starts:
            return
        self.simulator.reset(rows, starts, [self._rngs[row] for row in rows])
        if self._encoder.past_steps:
            first = self._view()
            self._past = self._past or tuple(first.copy() for _ in range(self._encoder.past_steps))
            for view in self._past:
                view.set_rows(rows, first)
        self._failed.begin(rows, starts)
        self._start_kind[rows] = [start.kind for start in starts]
        self._start_index[rows] = [start.index for start in starts]
        self._ended[rows] = False
        for row in rows:
            self._trails[row] = [self.simulator.eta[row].copy()]

    def _restart(self, ended: Bools) -> None:
        """Start the next episode of the boats (n,) that ended."""
        rows = np.flatnonzero(ended)
        self._begin(rows, self._draw(rows))

    def _commands(self, actions: NDArray[Any]) -> Floats:
        """Return the commands (n, 2) [N, rad] of the actions.

        Raises:
            gymnasium.error.InvalidAction: the actions are not in the action space.
            DockctlError: the action type returned the wrong shape.
        """
        chosen, dtype = np.asarray(actions), self.action_space.dtype
        if dtype is not None and np.can_cast(chosen.dtype, dtype, "same_kind"):
            chosen = chosen.astype(dtype)
        if not self.action_space.contains(chosen):
            raise error.InvalidAction(f"expected actions of {self.action_space}, got {actions}")
        kind = self.scenario.actions.kind
        with Guard(ACTIONS, kind):
            previous, vessel = self.simulator.command.copy(), self.scenario.vessel
            commands = np.asarray(self.scenario.actions.next_commands(chosen, vessel, previous), float)
            require_shape(f"action type '{kind}'", commands.shape, (self.num_envs, 2))
        return commands

    def _observe(self) -> Observations:
        return self.observe(self.simulator.sector_ranges_m)

    def _view(self) -> View:
        return View.of(self.simulator, self.simulator.sector_ranges_m, self._past)

    def _info(self, events: Info) -> Info:
        """Return copies of the state of every boat, and the events."""
        return {
            **of_boats(self.simulator),
            "start_kind": self._start_kind.copy(),
            "start_index": self._start_index.copy(),
            **of_conditions(self.simulator),
            **events,
        }

    def _extend_trails(self) -> None:
        if self.render_mode is not None:
            for trail, eta in zip(self._trails, self.simulator.eta, strict=True):
                trail.append(eta.copy())


def _resolve(scenario: ScenarioSource, base_dir: Path | None) -> tuple[Scenario, Path]:
    if isinstance(scenario, Scenario):
        return scenario, base_dir or Path.cwd()
    loaded = scenario if isinstance(scenario, LoadedScenario) else load_checked(scenario)
    return loaded.scenario, loaded.base_dir


def _by_boat(view: View) -> Info:
    return {name: getattr(view, name) for name in BY_BOAT}
