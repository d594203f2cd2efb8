"""Plans for the last meters to the final pose, and safe actions otherwise, in estimated wind and current."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy
from dockctl.compute import map_on_all_cores
from dockctl.control.forecast import Forecast
from dockctl.control.plans import RandomPlans
from dockctl.control.safety_filter import SafetyFilter, touching
from dockctl.envs.vector import DockingVectorEnv
from dockctl.geometry import Floats, Ints
from dockctl.scenarios.schema import Scenario
from dockctl.sim.goal import TO_FINAL, measure

WITHIN_M, PLAN_S = 7.0, 60.0
"""Distance from the final pose within which the boat plans, and the length of a plan."""
LATER_M, LATER_S = 15.0, 120.0
"""The distance for a boat that has not docked in this time since the intermediate pose."""
RANDOM, ROUNDS, CHANGES, KEPT = 300, 11, 150, 10
"""Numbers of random plans, of rounds and of changes in each, and of best plans that are changed."""
GOOD, ENOUGH = 0.5, 1.0
"""Share of the final pose's limits that a plan should need, and up to which the boat follows it."""
FARTHER_RADPM, FARTHER_PS = 0.1, 0.1
"""Heading error [rad] and speed [m/s] that are allowed in addition for each meter too far away, where a plan
cannot end yet: from so far a boat can still turn and stop."""
WEIGHT_S = 100.0
"""How much longer a plan may take to need less by the whole limits."""
MARGIN_M = 0.25
"""Clearance of a plan; approximate clearances are about 0.05 m off."""
CHECKED, CHECKED_AT_ONCE = 256, 32
"""Numbers of plans whose clearance is computed, the best first, and of those at once."""


def has_planner(scenario: Scenario) -> bool:
    """Return whether a planner runs policies: the scenario says so, and actions are single commands."""
    wanted = bool(scenario.evaluation.planner)
    return wanted and scenario.actions.command_table(scenario.vessel) is not None


class _Plans(NamedTuple):
    """Some plans.

    Attributes:
        actions: (k, steps).
        poses: (k, 2 steps, 3) after every half of a step.
        last: (k,) best step to end with.
        needed: (k,) share of the final pose's limits that is needed then.
        cost: (k,) what is minimized [s].
    """

    actions: NDArray[Any]
    poses: NDArray[Any]
    last: NDArray[Any]
    needed: NDArray[Any]
    cost: NDArray[Any]

    def at(self, index: Ints | slice) -> _Plans:
        return _Plans(*(each[index] for each in self))

    def best_with(self, others: _Plans) -> _Plans:
        """Return the best of these and other plans, the best one first."""
        both = _Plans(*map(np.concatenate, zip(self, others, strict=True)))
        return both.at(both.cost.argsort(kind="stable")[:KEPT])


class Planner(Policy):
    """Runs a policy, and near the final pose follows a plan that reaches it soon, if it finds one.

    Model predictive control with an evolutionary search: a plan is a sequence of the policy's commands,
    predicted by a `Forecast`, and kept clear of the harbor, which the policy does not know. In every control
    step the best plans of the step before, without their first commands, are compared with random ones, and
    the best plans of all are changed at random, round after round. While no plan reaches the final pose, the
    policy acts, and a `SafetyFilter` may replace its actions.

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
        self._plans = RandomPlans(commands, self._steps, self._period_s)
        self._filter = SafetyFilter(self._simulator, self._forecast, self._commands, self._period_s)
        self._rngs = [np.random.default_rng(0)] * env.num_envs
        self._best = dict[int, _Plans]()
        self._tried_s = np.zeros(env.num_envs)

    def reset(self, rows: Ints, info: Info) -> None:
        """Forget the episodes of the boats `rows` (k,); see `Policy`."""
        self._policy.reset(rows, info)
        self._forecast.reset(rows)
        self._tried_s[rows] = 0.0
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
        to_final = simulator.phase == TO_FINAL
        near = to_final & (distance < np.where(self._tried_s < LATER_S, WITHIN_M, LATER_M))
        self._tried_s[to_final] += self._period_s

        def chosen(row: int) -> int:
            kept = self._best.pop(row, None)
            planned = self._planned(row, poses[row], kept) if near[row] else None
            if planned is None:
                return self._filter.safe(row, poses[row], int(actions[row]))
            self._filter.forget_plan(row)
            return planned

        rows = np.flatnonzero(~simulator.resting).tolist()
        actions[rows] = map_on_all_cores(chosen, rows)
        self._forecast.command(self._commands[actions])
        return actions

    def _planned(self, row: int, pose: Floats, kept: _Plans | None) -> int | None:
        """Return the first action of the best plan of a boat at a pose (3,), or None if none docks.

        Args:
            kept: the best plans of the control step before.
        """
        rng, tried = self._rngs[row], self._plans.draw(self._rngs[row], RANDOM)
        here_m = float(self._simulator.obstacles(row).approximate_clearance(pose))
        if kept is not None:
            tried = np.vstack([np.hstack([kept.actions[:, 1:], kept.actions[:, -1:]]), tried])
        best = self._clear(row, self._predicted(row, tried), here_m)
        if len(best.cost) == 0:
            return None
        for _ in range(ROUNDS):
            if best.needed[0] <= GOOD:
                break
            changed = self._predicted(row, self._plans.changes(rng, best.actions, best.last + 1, CHANGES))
            better = changed.cost < (best.cost[-1] if len(best.cost) == KEPT else np.inf)
            best = best.best_with(self._clear(row, changed.at(np.flatnonzero(better)), here_m))
        self._best[row] = best
        return int(best.actions[0, 0]) if best.needed[0] <= ENOUGH else None

    def _predicted(self, row: int, actions: Ints) -> _Plans:
        poses, velocities = self._forecast.poses(row, self._commands[actions])
        needed = self._needed(self._simulator.goal[[row]], poses[:, 1::2], velocities)
        cost = WEIGHT_S * np.maximum(needed - GOOD, 0) + self._period_s * np.arange(self._steps)
        last, plan = cost.argmin(axis=1), np.arange(len(cost))
        return _Plans(actions, poses, last, needed[plan, last], cost[plan, last])

    def _needed(self, goal: Floats, eta: Floats, velocity: Floats) -> Floats:
        """Return the largest share of the final pose's limits that poses and velocities need, (m, k)."""
        distance, heading_error = measure(eta.reshape(-1, 3), goal)
        speed, limit = np.hypot(*velocity.reshape(-1, 2).T), self._limit
        farther = np.maximum(distance - limit.distance_m, 0)
        shares = (
            distance / limit.distance_m,
            np.abs(heading_error) / (limit.heading + FARTHER_RADPM * farther),
            speed / (limit.speed_mps + FARTHER_PS * farther),
        )
        return np.asarray(np.max(shares, axis=0).reshape(eta.shape[:2]))

    def _clear(self, row: int, plans: _Plans, here_m: float) -> _Plans:
        """Return the best plans that stay clear up to their last step, the best one first.

        Args:
            here_m: clearance of the boat.
        """
        clearance, found = self._simulator.obstacles(row).approximate_clearance, list[int]()
        order = plans.cost.argsort(kind="stable")[:CHECKED]
        for begin in range(0, len(order), CHECKED_AT_ONCE):
            some = order[begin : begin + CHECKED_AT_ONCE]
            touched = touching(clearance(plans.poses[some]), MARGIN_M, here_m)
            touched &= np.arange(touched.shape[1]) <= 2 * plans.last[some, None] + 1
            found += some[~touched.any(axis=1)].tolist()
            if len(found) >= KEPT:
                break
        return plans.at(np.array(found[:KEPT], np.int64))
