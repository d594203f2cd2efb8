"""A supervisor of a policy: it replaces actions that lead to contact, and makes a waiting boat move.

It predicts with the vessel's equations of motion and the map of the harbor, which the policy does not know.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy, QPolicy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import Floats, Ints
from dockctl.scenarios.schema import Scenario
from dockctl.sim.swept import first_contact

STOPPED_MPS = 0.005
"""A boat has stopped when all points of its hull are slower."""
LONGEST_STOP_S = 30.0
"""Maximum time without thrust of a prediction, for vessels that take longer to stop."""
WAITING_S, WAITING_M = 15.0, 1.5
"""A boat is waiting if it stayed in a square of this size for this long."""
RECOVERY_S = 10.0
"""How long a waiting boat keeps a random command."""


def has_supervisor(policy: object, scenario: Scenario) -> bool:
    """Return whether a supervisor runs the policy: the scenario says so, and it values single commands."""
    wanted = bool(scenario.evaluation.supervisor) and isinstance(policy, QPolicy)
    return wanted and scenario.actions.command_table(scenario.vessel) is not None


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
        policy: a `QPolicy`.
        env: where it runs, with discrete actions that are commands.
    """

    def __init__(self, policy: Policy, env: DockingVectorEnv) -> None:
        commands = env.scenario.actions.command_table(env.scenario.vessel)
        assert isinstance(policy, QPolicy) and commands is not None
        self._policy, self._q_values = policy, policy.q_values
        self._simulator, self._hull = env.simulator, env.scenario.vessel.hull
        self._commands = commands
        period, boats = env.scenario.vessel.control_period_s, env.num_envs
        waiting, self._recovery = (max(1, round(time / period)) for time in (WAITING_S, RECOVERY_S))
        self._periods_to_stop = self._count_periods_to_stop(round(LONGEST_STOP_S / period))
        self._positions = np.full((boats, waiting + 1, 2), np.nan)
        self._recovering = np.zeros(boats, np.int64)  # remaining steps of a recovery
        self._random_order = np.zeros((boats, len(commands)), np.int64)
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
        actions = np.array(self._policy.act(observation, info))
        self._begin_recoveries(eta[:, :2])
        recovering = self._recovering > 0
        self._recovering[recovering] -= 1
        actions[recovering] = self._random_order[recovering, 0]
        paths = self._paths(eta, nu, self._commands[actions])
        active = np.flatnonzero(~self._simulator.resting).tolist()
        for row in [row for row in active if not self._is_free(row, paths[row])]:
            ranked = (-self._q_values(observation[[row]])[0]).argsort(kind="stable")
            order = self._random_order[row] if recovering[row] else ranked
            same = [row] * len(order)
            candidates = self._paths(eta[same], nu[same], self._commands[order])
            safe = (
                action for action, path in zip(order, candidates, strict=True) if self._is_free(row, path)
            )
            actions[row] = next(safe, actions[row])
        return actions

    def _begin_recoveries(self, position: Floats) -> None:
        """Record the positions (n, 2), and begin a recovery of each boat that is waiting."""
        self._positions[:, :-1] = self._positions[:, 1:]
        self._positions[:, -1] = position
        waiting = np.ptp(self._positions, axis=1).max(axis=1) < WAITING_M  # NaN is not
        for row in np.flatnonzero(waiting & (self._recovering == 0)).tolist():
            order = self._rngs[row].permutation(len(self._commands))
            thrust = self._commands[order, 0]
            self._random_order[row] = np.concatenate([order[thrust != 0], order[thrust == 0]])
            self._recovering[row] = self._recovery
            self._positions[row] = np.nan

    def _count_periods_to_stop(self, most: int) -> int:
        """Return after how many control periods without thrust a boat has stopped, from steady speeds."""
        vessel = self._simulator.vessel
        eta = nu = np.zeros((len(self._commands), 3))
        for _ in range(most):
            eta, nu = vessel.step(eta, nu, self._commands)
        for periods in range(1, most):
            eta, nu = vessel.step(eta, nu, np.zeros_like(self._commands))
            if (np.hypot(nu[:, 0], nu[:, 1]) + self._hull.reach_m * np.abs(nu[:, 2])).max() < STOPPED_MPS:
                return periods
        return most

    def _paths(self, eta: Floats, nu: Floats, commands: Floats) -> Floats:
        """Predict poses (n, k, 3) while commands (n, 2) are held for a control period, then without thrust.

        k is the same for all boats and steps, so that a prediction does not depend on the boats beside it.
        """
        vessel = self._simulator.vessel
        tau = vessel.tau(commands)[:, None]
        parts = [vessel.path(eta, nu, tau)]
        for _ in range(self._periods_to_stop):
            eta, nu = parts[-1][:, -1, :3].copy(), parts[-1][:, -1, 3:].copy()
            parts.append(vessel.path(eta, nu, np.zeros_like(tau))[:, 1:])
        return np.concatenate(parts, axis=1)[:, :, :3]

    def _is_free(self, row: int, path: Floats) -> bool:
        """Return whether the hull of a boat touches nothing on a path (k, 3)."""
        return first_contact(path, self._simulator.obstacles(row), self._hull) is None
