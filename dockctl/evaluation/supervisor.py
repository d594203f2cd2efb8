"""A supervisor of a policy: it replaces actions that lead to contact, and makes a waiting boat move.

It predicts with the vessel's equations of motion and the map of the harbor, which the policy does not know.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy, QPolicy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import Floats, Ints
from dockctl.sim.collision import first_contact

STOPPED_MPS = 0.005
"""A boat has stopped when all points of its hull are slower."""
LONGEST_STOP_S = 30.0
"""The prediction ends after this time without thrust."""
WAITING_S, WAITING_M = 15.0, 1.5
"""A boat is waiting if it stayed in a square of this size for this long."""
RECOVERY_S = 10.0
"""How long a waiting boat keeps a random command."""


def supervised(policy: Policy, env: DockingVectorEnv) -> Policy:
    """Return the policy, with a supervisor if it chooses among discrete actions by their values."""
    if isinstance(policy, QPolicy) and isinstance(env.single_action_space, Discrete):
        return Supervisor(policy, env)
    return policy


class Supervisor(Policy):
    """Runs a policy, and replaces the actions of boats that would touch something or are waiting.

    An action is safe if the hull touches nothing while the command is held for one control period, and after
    that without thrust until the boat has stopped. Instead of an unsafe action, the boat takes the safe one
    with the highest value: a predictive safety filter (Wabersich and Zeilinger 2021, Automatica 129, 109597)
    whose backup is to stop. Since no thrust is safe after a safe action, a boat that starts at rest never
    collides in calm water, if one of the actions has no thrust.

    A waiting boat gets a random command with thrust, the first safe one of a random order. The orders are the
    same in every episode, so that an episode does not depend on those beside it.

    Args:
        policy: chooses among discrete actions by their values.
        env: where it runs.
    """

    def __init__(self, policy: Policy, env: DockingVectorEnv) -> None:
        assert isinstance(policy, QPolicy) and isinstance(env.single_action_space, Discrete)
        self._policy, self._q_values = policy, policy.q_values
        self._simulator, self._scenario = env.simulator, env.scenario
        self._all_actions = np.arange(env.single_action_space.n)
        period, boats = env.scenario.vessel.control_period_s, env.num_envs
        self._longest_stop, self._waiting, self._recovery = (
            max(1, round(time / period)) for time in (LONGEST_STOP_S, WAITING_S, RECOVERY_S)
        )
        self._positions = np.full((boats, self._waiting + 1, 2), np.nan)
        self._recovering = np.zeros(boats, np.int64)  # remaining steps of a recovery
        self._random_order = np.zeros((boats, len(self._all_actions)), np.int64)
        self._rngs = [np.random.default_rng(0)] * boats

    def reset(self, rows: Ints, info: Info) -> None:
        """Forget the episodes of the boats `rows` (k,); see `Policy`."""
        self._policy.reset(rows, info)
        self._positions[rows] = np.nan
        self._recovering[rows] = 0
        for row in rows.tolist():
            self._rngs[row] = np.random.default_rng(0)

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[np.int64]:
        """Return an action for each boat; see `Policy`."""
        eta, nu = (info.get(f"measured_{key}", info[key]) for key in ("pose", "velocity"))
        previous = info["command"]
        actions = np.array(self._policy.act(observation, info))
        self._begin_recoveries(eta[:, :2], previous)
        recovering = self._recovering > 0
        self._recovering[recovering] -= 1
        actions[recovering] = self._random_order[recovering, 0]
        values = self._q_values(observation)
        paths = self._paths(eta, nu, self._commands(actions, previous))
        for row in np.flatnonzero(~self._simulator.resting).tolist():
            if self._is_free(row, paths[row]):
                continue
            order = self._random_order[row] if recovering[row] else (-values[row]).argsort(kind="stable")
            alternatives = self._commands(order, previous[[row] * len(order)])
            candidates = self._paths(eta[[row]], nu[[row]], alternatives)
            safe = (
                action for action, path in zip(order, candidates, strict=True) if self._is_free(row, path)
            )
            actions[row] = next(safe, actions[row])
        return actions

    def _begin_recoveries(self, position: Floats, previous: Floats) -> None:
        """Record the positions (n, 2), and begin a recovery of each boat that is waiting."""
        self._positions[:, :-1] = self._positions[:, 1:]
        self._positions[:, -1] = position
        waiting = np.ptp(self._positions, axis=1).max(axis=1) < WAITING_M  # NaN is not
        for row in np.flatnonzero(waiting & (self._recovering == 0)).tolist():
            order = self._rngs[row].permutation(self._all_actions)
            thrust = self._commands(order, previous[[row] * len(order)])[:, 0]
            self._random_order[row] = np.concatenate([order[thrust != 0], order[thrust == 0]])
            self._recovering[row] = self._recovery
            self._positions[row] = np.nan

    def _commands(self, actions: Ints, previous: Floats) -> Floats:
        return self._scenario.actions.next_commands(actions, self._scenario.vessel, previous)

    def _paths(self, eta: Floats, nu: Floats, commands: Floats) -> Floats:
        """Predict the poses (n, k, 3) while commands (n, 2) are held for a period, then until a stop."""
        vessel, reach = self._simulator.vessel, self._scenario.vessel.hull.reach_m
        tau = vessel.tau(commands)[:, None]
        eta, nu = (np.broadcast_to(given, (len(commands), 3)) for given in (eta, nu))
        parts = [vessel.path(eta, nu, tau)]
        for _ in range(self._longest_stop):
            last = parts[-1][:, -1]
            if (np.hypot(last[:, 3], last[:, 4]) + reach * np.abs(last[:, 5])).max() < STOPPED_MPS:
                break
            coasting = vessel.path(last[:, :3].copy(), last[:, 3:].copy(), np.zeros_like(tau))
            parts.append(coasting[:, 1:])
        return np.concatenate(parts, axis=1)[:, :, :3]

    def _is_free(self, row: int, path: Floats) -> bool:
        """Return whether the hull of a boat touches nothing on a path (k, 3)."""
        obstacles = self._simulator.worlds[int(self._simulator.harbor[row])].obstacles
        hull = self._scenario.vessel.hull
        return first_contact(path, obstacles, hull) is None
