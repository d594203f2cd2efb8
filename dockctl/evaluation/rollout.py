"""Run a policy from given starts and record each episode."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy
from dockctl.control.planner import Planner, has_planner
from dockctl.control.supervisor import Supervisor, has_supervisor
from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import Floats
from dockctl.runs.tables import CONDITION_COLUMNS, TRAJECTORIES, Value, all_columns, to_csv
from dockctl.scenarios.loader import LoadedScenario
from dockctl.sim.checks import located
from dockctl.sim.starts import Start
from dockctl.sim.swept import least_clearance
from dockctl.sim.world import World, build_worlds

PARALLEL_BOATS = 128
"""Boats per batch: more would save hardly any time per boat, and their trajectories take memory."""
FIRST_CAPACITY = 256
"""Steps of an episode for which memory is reserved; longer ones double it."""
TRIED_FIRST = 16
"""Number of first starts of a validation that decide whether it continues."""


class HasPose(Protocol):
    """What an episode reports about its start, which may belong to a third-party environment."""

    @property
    def eta(self) -> Floats: ...
    @property
    def kind(self) -> str: ...
    @property
    def berth(self) -> str: ...


Clearance = Callable[[Any, Floats], float]

RECORDED = ("pose", "velocity", "command", "distance_m", "heading_error_rad", "phase", "sector_ranges_m")
OPTIONAL = ("current", "wind", "actuation", "measured_pose", "measured_velocity")
"""Only in scenarios with such conditions."""


@dataclass(frozen=True, eq=False)
class Episode:
    """One episode and its trajectory.

    Attributes:
        outcome: ``docked``, ``collision`` or ``timeout``.
        collided_with: name of the obstacle, or empty.
        phase: final phase, 0 or 1.
        total_reward: undiscounted return.
        trajectory: arrays of steps + 1 rows by info key, ``observation``, ``reward`` and ``reward_<term>``;
            row 0 is the start.
        clearance_m: minimum distance between hull and harbor [m]; NaN if it was not measured.
        conditions: what the conditions drew for the episode, by name.
    """

    start: HasPose
    outcome: str
    collided_with: str
    phase: int
    total_reward: float
    trajectory: dict[str, NDArray[Any]]
    clearance_m: float = math.nan
    conditions: Mapping[str, float] = field(default_factory=dict)

    @property
    def docked(self) -> bool:
        return self.outcome == "docked"

    @property
    def steps(self) -> int:
        return len(self.trajectory["reward"]) - 1

    @property
    def path_length_m(self) -> float:
        return float(np.hypot(*np.diff(self.trajectory["pose"][:, :2], axis=0).T).sum())

    @property
    def control_changes(self) -> float:
        """Fraction of the steps in which the propeller or rudder command changes."""
        commands = self.trajectory["command"][1:]
        changed = (np.diff(commands, axis=0) != 0).any(axis=1)
        return float(changed.mean()) if len(changed) else 0.0

    @property
    def speed_mps(self) -> float:
        """Final speed over ground of the center of gravity [m/s]; in a collision, the speed at contact."""
        u, v, _ = self.trajectory["velocity"][-1]
        return math.hypot(u, v)

    def maneuver(self) -> dict[str, Value]:
        """Return the columns `dockctl.runs.tables.MANEUVER`."""
        changes = np.abs(np.diff(self.trajectory["command"][1:], axis=0))
        force, angle = changes.mean(axis=0) if len(changes) else (0.0, 0.0)
        return {
            "contact_speed_mps": self.speed_mps if self.outcome == "collision" else None,
            "propeller_change_n": float(force),
            "rudder_change_deg": math.degrees(angle),
        }

    def row(self) -> dict[str, Value]:
        """Return the columns `dockctl.runs.tables.EPISODE_RESULT`, and one for each value of a condition."""
        return {
            "outcome": self.outcome,
            "collided_with": self.collided_with,
            "phase": self.phase,
            "return": self.total_reward,
            "steps": self.steps,
            "distance_m": float(self.trajectory["distance_m"][-1]),
            "heading_error_deg": math.degrees(self.trajectory["heading_error_rad"][-1]),
            "speed_mps": self.speed_mps,
            "path_length_m": self.path_length_m,
            "clearance_m": None if math.isnan(self.clearance_m) else self.clearance_m,
            "control_changes": self.control_changes,
            **self.conditions,
        }


class Rollout:
    """Runs policies in one scenario; its harbors are built once and shared by the environments.

    Args:
        loaded: the scenario.
        worlds: its harbors; built if they are not given.

    Raises:
        DockctlError: the harbor cannot be built.
    """

    def __init__(self, loaded: LoadedScenario, worlds: Sequence[World] | None = None) -> None:
        self.loaded, self.scenario = loaded, loaded.scenario
        self.worlds = worlds or build_worlds(loaded.scenario, loaded.base_dir)
        self._reach_m = loaded.scenario.vessel.hull.reach_m
        self._environments: dict[int, DockingVectorEnv] = {}

    def env(self, boats: int = 1) -> DockingVectorEnv:
        """Return the environment with this number of boats, without autoreset.

        Drawing a start would require building every training harbor.
        """
        if boats not in self._environments:
            self._environments[boats] = DockingVectorEnv(
                self.loaded, boats, autoreset_mode=AutoresetMode.DISABLED, worlds=self.worlds
            )
        return self._environments[boats]

    def run(self, policy: Policy, starts: Sequence[Start], *, clearance: bool = True) -> list[Episode]:
        """Run one episode from each start, in order; by default with its clearance.

        With `evaluation.supervisor`, a `Supervisor` may replace actions of the policy, and with
        `evaluation.planner`, a `Planner`.

        The conditions of episode i are drawn from the seed `evaluation.conditions_seed` + i, unless the start
        has a seed: they depend neither on the policy nor on the number of boats.

        Raises:
            InputError: the scenario's conditions do not match its vessel or range sensor.
        """
        if not starts:
            return []
        env, measure = self.env(min(PARALLEL_BOATS, len(starts))), self._clearance if clearance else None
        with located(self.loaded):
            return run_episodes(env, controlled(policy, env), self.seeded(starts), measure)

    def seeded(self, starts: Sequence[Start]) -> list[Start]:
        """Return the starts; those without a seed get `evaluation.conditions_seed` and their number."""
        first = self.scenario.evaluation.conditions_seed
        return [
            replace(start, seed=first + number if start.seed is None else start.seed)
            for number, start in enumerate(starts)
        ]

    def at_start(self, start: Start) -> Episode:
        """Return the episode from a start before its first step."""
        env = self.env(1)
        observation, info = env.reset(options={"starts": [start]})
        return _episode(_step(observation, info, np.zeros(1)), info, 0, start, None)

    def validate(self, policy: Policy, starts: Sequence[Start]) -> list[Episode]:
        """Run one episode from each start, but stop after the first 16 if fewer than half of these dock.

        Most episodes of such a policy end with a timeout, so they take longest.
        """
        first = self.run(policy, starts[:TRIED_FIRST], clearance=False)
        if 2 * sum(episode.docked for episode in first) < len(first):
            return first
        return first + self.run(policy, starts[TRIED_FIRST:], clearance=False)

    def _clearance(self, start: Start, poses: Floats) -> float:
        return least_clearance(poses, self.worlds[start.harbor].obstacles.clearance, self._reach_m)


def controlled(policy: Policy, env: DockingVectorEnv) -> Policy:
    """Return the policy with the supervisor and the planner that its scenario has, if any."""
    if has_supervisor(policy, env.scenario):
        policy = Supervisor(policy, env)
    return Planner(policy, env) if has_planner(env.scenario) else policy


def run_episodes(
    env: VectorEnv[Any, Any, Any],
    policy: Policy,
    starts: Sequence[HasPose],
    clearance: Clearance | None = None,
) -> list[Episode]:
    """Run one episode from each start; a boat whose episode has ended takes the next start, or rests.

    Args:
        env: without autoreset; takes ``reset(options={"starts": n, "reset_mask": (n,)})``, where the start of
            a resting boat is None.
        starts: any number of starts, k.
        clearance: minimum distance to the harbor [m], given a start and the poses (m, 3) of its episode.

    Returns:
        The k episodes in the order of the starts.
    """
    waiting, episodes = deque(enumerate(starts)), dict[int, Episode]()
    assigned: dict[int, tuple[int, HasPose]] = {}  # to each boat, the start of its episode
    recorder = _Recorder(env.num_envs)
    seed: int | None = 0  # of the first reset only
    ended = np.ones(env.num_envs, bool)
    while len(episodes) < len(starts):
        if ended.any():
            begun = {boat: waiting.popleft() for boat in np.flatnonzero(ended).tolist() if waiting}
            given = [begun[boat][1] if boat in begun else None for boat in range(env.num_envs)]
            options = {"starts": given, "reset_mask": ended}
            observation, info = env.reset(seed=seed, options=options)
            seed = None
            assigned |= begun
            if begun:
                boats = np.array(list(begun))
                policy.reset(boats, info)
                recorder.begin(boats, _step(observation, info, np.zeros(env.num_envs)))
        observation, reward, terminated, truncated, info = env.step(policy.act(observation, info))
        recorder.add(np.array(list(assigned)), _step(observation, info, reward))
        ended = terminated | truncated
        for boat in np.flatnonzero(ended).tolist():
            index, start = assigned.pop(boat)
            episodes[index] = _episode(recorder.trajectory(boat), info, boat, start, clearance)
    return [episodes[index] for index in range(len(starts))]


def _step(observation: NDArray[Any], info: Info, reward: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Return what is recorded of all boats after a step, (n, ...) by name."""
    terms = {f"reward_{name}": term for name, term in info.get("reward_terms", {}).items()}
    measured = {key: info[key] for key in (*RECORDED, *OPTIONAL) if key in RECORDED or key in info}
    recorded = {"observation": observation, **measured, **terms, "reward": reward}
    return {key: np.asarray(values) for key, values in recorded.items()}


class _Recorder:
    """Records the steps of the boats' current episodes."""

    def __init__(self, boats: int) -> None:
        self._recorded = np.zeros(boats, np.int64)  # rows of each boat's episode
        self._rows: dict[str, NDArray[Any]] = {}  # (boats, capacity, ...) by name

    def begin(self, boats: NDArray[np.int64], step: Mapping[str, NDArray[Any]]) -> None:
        """Record the starts of these boats (k,), given what `_step` returned."""
        self._recorded[boats] = 0
        self.add(boats, step)

    def add(self, boats: NDArray[np.int64], step: Mapping[str, NDArray[Any]]) -> None:
        """Record a step of these boats (k,), given what `_step` returned."""
        if not self._rows:
            shapes = {key: (len(values), FIRST_CAPACITY, *values.shape[1:]) for key, values in step.items()}
            self._rows = {key: np.zeros(shape, step[key].dtype) for key, shape in shapes.items()}
        slots = self._recorded[boats]
        for key, values in step.items():
            if slots.max() == self._rows[key].shape[1]:
                self._rows[key] = np.concatenate([self._rows[key], np.zeros_like(self._rows[key])], axis=1)
            self._rows[key][boats, slots] = values[boats]
        self._recorded[boats] += 1

    def trajectory(self, boat: int) -> dict[str, NDArray[Any]]:
        """Return a copy of the rows of one boat's episode, (steps + 1, ...) by name."""
        return {key: rows[boat, : self._recorded[boat]].copy() for key, rows in self._rows.items()}


def _episode(
    trajectory: dict[str, NDArray[Any]], info: Info, boat: int, start: HasPose, clearance: Clearance | None
) -> Episode:
    """Return the episode of a boat with this trajectory, given the `info` of its last step."""
    return Episode(
        start=start,
        outcome=str(info["outcome"][boat]),
        collided_with=str(info["collided_with"][boat] or ""),
        phase=int(trajectory["phase"][-1]),
        total_reward=sum(trajectory["reward"].tolist()),
        trajectory=trajectory,
        clearance_m=math.nan if clearance is None else clearance(start, trajectory["pose"]),
        conditions={name: float(drawn[boat]) for name, drawn in info.get("conditions", {}).items()},
    )


def evaluation_rows(episodes: Sequence[Episode]) -> list[dict[str, Value]]:
    """Return the rows of ``evaluations.csv`` for the episodes of one policy from one set of starts."""
    return [{"start_kind": e.start.kind, "pose": pose, **e.row()} for pose, e in enumerate(episodes)]


def trajectories_csv(episodes: Sequence[Episode], control_period_s: float) -> str:
    """Return the text of ``trajectories.csv``."""
    rows = list(_trajectory_rows(episodes, control_period_s))
    return to_csv(rows, all_columns(TRAJECTORIES, rows))


def _trajectory_rows(episodes: Sequence[Episode], control_period_s: float) -> Iterator[dict[str, Value]]:
    """Yield one row per control step."""
    for pose, episode in enumerate(episodes):
        recorded = episode.trajectory
        for step in range(episode.steps + 1):
            x, y, heading = recorded["pose"][step]
            u, v, r = recorded["velocity"][step]
            force, angle = recorded["command"][step]
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
                "distance_m": recorded["distance_m"][step],
                "heading_error_deg": math.degrees(recorded["heading_error_rad"][step]),
                "phase": int(recorded["phase"][step]),
                "reward": recorded["reward"][step],
                **{f"range_{i}_m": d for i, d in enumerate(recorded["sector_ranges_m"][step], start=1)},
                **{
                    column: math.degrees(recorded[key][step, i])
                    if "deg" in column
                    else recorded[key][step, i]
                    for key, columns in CONDITION_COLUMNS.items()
                    if key in recorded
                    for i, column in enumerate(columns)
                },
            }
