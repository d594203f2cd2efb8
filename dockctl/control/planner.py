"""Plans for the last meters to the final pose, and safe actions before, with estimated wind and current."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy
from dockctl.compute import map_on_all_cores
from dockctl.control.forecast import Forecast
from dockctl.control.plans import RandomPlans
from dockctl.control.safety_filter import SafetyFilter
from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import Floats, Ints
from dockctl.scenarios.schema import Scenario
from dockctl.sim.goal import TO_FINAL, measure

WITHIN_M, PLAN_S = 7.0, 30.0
"""Distance from the final pose within which the boat plans, and the length of a plan."""
PLANS = 1000
"""Number of random plans of which the best one is taken."""
GOOD, ENOUGH = 0.7, 1.0
"""Share of the final pose's limits that a plan should need, and up to which the boat follows it."""
WEIGHT_S = 100.0
"""How much longer a plan may take to need less by the whole limits."""
MARGIN_M = 0.25
"""Clearance of a plan; approximate clearances are about 0.05 m off."""
CHECKED_AT_ONCE = 32
"""Number of plans whose clearance is computed at once, the best first."""


def has_planner(scenario: Scenario) -> bool:
    """Return whether a planner runs policies: the scenario says so, and actions are single commands."""
    wanted = bool(scenario.evaluation.planner)
    return wanted and scenario.actions.command_table(scenario.vessel) is not None


class Planner(Policy):
    """Runs a policy, and near the final pose follows the random plan that reaches it first, if there is one.

    Random-shooting model predictive control: a plan is a sequence of the policy's commands, predicted by a
    `Forecast`, and kept clear of the harbor, which the policy does not know. In every control step half of
    the plans are random changes of the best plan of the step before, without its first command. While no
    plan reaches the final pose, the policy acts. Farther away, a `SafetyFilter` may replace its actions.

    The plans are the same in every episode, so that an episode does not depend on those beside it.

    Args:
        policy: acts everywhere else.
        env: where it runs, with discrete actions that are commands.
    """

    def __init__(self, policy: Policy, env: DockingVectorEnv) -> None:
        self._policy, self._simulator, vessel = policy, env.simulator, env.scenario.vessel
        commands = env.scenario.actions.command_table(vessel)
        assert commands is not None
        self._commands = commands
        self._forecast, self._limit = Forecast(env.simulator, env.scenario), env.scenario.task.final_tolerance
        self._period_s = vessel.control_period_s
        self._steps = max(1, round(PLAN_S / self._period_s))
        self._plans = RandomPlans(len(commands), self._steps, self._period_s)
        self._filter = SafetyFilter(self._simulator, self._forecast, self._commands, self._period_s)
        self._rngs = [np.random.default_rng(0)] * env.num_envs
        self._best = dict[int, Ints]()

    def reset(self, rows: Ints, info: Info) -> None:
        """Forget the episodes of the boats `rows` (k,); see `Policy`."""
        self._policy.reset(rows, info)
        self._forecast.reset(rows)
        for row in rows.tolist():
            self._rngs[row] = np.random.default_rng(0)
            self._best.pop(row, None)
            self._filter.reset(row)

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[np.int64]:
        """Return an action for each boat; see `Policy`."""
        simulator, actions = self._simulator, np.array(self._policy.act(observation, info))
        poses = simulator.measured_pose()
        self._forecast.measure(poses, simulator.measured_velocity())
        distance, _ = measure(poses, simulator.goal)

        def chosen(row: int) -> int:
            if simulator.phase[row] == TO_FINAL and distance[row] < WITHIN_M:
                planned = self._planned(row)
                return int(actions[row]) if planned is None else planned
            return self._filter.safe(row, poses[row], int(actions[row]))

        rows = np.flatnonzero(~simulator.resting).tolist()
        actions[rows] = map_on_all_cores(chosen, rows)
        self._forecast.command(self._commands[actions])
        return actions

    def _planned(self, row: int) -> int | None:
        """Return the first action of the best plan to the final pose, or None if none reaches it."""
        plans = self._plans.draw(self._rngs[row], PLANS, self._best.get(row))
        poses, velocities = self._forecast.poses(row, self._commands[plans])
        needed = self._needed(self._simulator.goal[[row]], poses[:, 1::2], velocities)
        cost = WEIGHT_S * np.maximum(needed - GOOD, 0) + self._period_s * np.arange(self._steps)
        last, order = cost.argmin(axis=1), cost.min(axis=1).argsort(kind="stable")
        best = self._first_clear(row, poses, order, last)
        if best is None:
            return None
        self._best[row] = plans[best]
        return int(plans[best, 0]) if needed[best, last[best]] <= ENOUGH else None

    def _needed(self, goal: Floats, eta: Floats, velocity: Floats) -> Floats:
        """Return the largest share of the final pose's limits that poses and velocities need, (m, k)."""
        distance, heading_error = measure(eta.reshape(-1, 3), goal)
        speed, limit = np.hypot(*velocity.reshape(-1, 2).T), self._limit
        shares = (
            distance / limit.distance_m,
            np.abs(heading_error) / limit.heading,
            speed / limit.speed_mps,
        )
        return np.asarray(np.max(shares, axis=0).reshape(eta.shape[:2]))

    def _first_clear(self, row: int, poses: Floats, order: Ints, last: Ints) -> int | None:
        """Return the first plan of an order that stays clear up to its last step, or None."""
        obstacles = self._simulator.obstacles(row)
        for some in np.array_split(order, max(1, len(order) // CHECKED_AT_ONCE)):
            touching = obstacles.approximate_clearance(poses[some]) < MARGIN_M
            touching &= np.arange(poses.shape[1]) <= 2 * last[some, None] + 1
            if len(clear := np.flatnonzero(~touching.any(axis=1))):
                return int(some[clear[0]])
        return None
