"""Replaces actions after which the boat cannot keep clear of the harbor."""

from __future__ import annotations

import numpy as np

from dockctl.control.forecast import Forecast
from dockctl.control.plans import RandomPlans
from dockctl.geometry import Bools, Floats, Ints
from dockctl.sim.simulator import Simulator

SAFE_S, SAFE_M = 30.0, 0.15
"""Length and clearance of a safe plan; approximate clearances are about 0.05 m off."""
NEAR_M = 2.5
"""Clearance above which actions are not checked."""
LOST_M = 0.02
"""How much of its clearance a boat that has less than a safe plan may lose."""
CONTINUATIONS, ESCAPES = (16, 112), 500
"""Numbers of random plans with the action that are tried, first some, then more, and of those without it."""
OPEN_M = 2.0
"""Clearance beyond which more of it makes a plan no better."""


def touching(clearance_m: Floats, usual_m: float, here_m: float) -> Bools:
    """Return where a plan is too close to the harbor.

    Args:
        clearance_m: of its poses.
        usual_m: how much a plan should have; a boat that has less may lose hardly any of it.
        here_m: clearance of the boat.
    """
    return clearance_m <= min(usual_m, max(here_m - LOST_M, 0.0))


class SafetyFilter:
    """Lets a boat take an action if a random plan that begins with it keeps clear, as far as predicted.

    Otherwise the boat follows the plan that keeps clear for the longest time, and of those that do so to
    their end the one with the largest mean clearance: a predictive safety filter (Wabersich and Zeilinger
    2021, Automatica 129, 109597).

    Args:
        simulator: of the boats.
        forecast: predicts them.
        commands: (actions, 2) command of each action [N, rad].
        control_period_s: for which an action holds.
    """

    def __init__(
        self, simulator: Simulator, forecast: Forecast, commands: Floats, control_period_s: float
    ) -> None:
        self._simulator, self._forecast, self._commands = simulator, forecast, commands
        self._steps = max(1, round(SAFE_S / control_period_s))
        self._plans = RandomPlans(commands, self._steps, control_period_s)
        self._rngs, self._best = dict[int, np.random.Generator](), dict[int, Ints]()

    def reset(self, row: int) -> None:
        """Forget the episode of a boat."""
        self._rngs[row] = np.random.default_rng(1)
        self.forget_plan(row)

    def forget_plan(self, row: int) -> None:
        """Forget the plan of a boat whose next action does not come from `safe`."""
        self._best.pop(row, None)

    def safe(self, row: int, pose: Floats, action: int) -> int:
        """Return the action of a boat at a pose (3,), or if it is not safe, that of the safest plan."""
        rng, best = self._rngs[row], self._best.pop(row, None)
        here = float(self._clearance(row, pose))
        if here > NEAR_M:
            return action
        for count in CONTINUATIONS:
            plans = self._plans.draw(rng, count)
            plans[:, 0] = action
            plan, steps = self._safest(row, plans, here)
            if steps == self._steps:
                self._best[row] = plan
                return action
        self._best[row], _ = self._safest(row, self._plans.draw(rng, ESCAPES, best), here)
        return int(self._best[row][0])

    def _safest(self, row: int, plans: Ints, here: float) -> tuple[Ints, float]:
        """Return the safest of some plans (m, steps), and for how many steps it keeps clear.

        Args:
            here: clearance now [m].
        """
        poses, _ = self._forecast.poses(row, self._commands[plans])
        clearance = self._clearance(row, poses)
        touched = touching(clearance, SAFE_M, here)
        until = np.where(touched.any(axis=1), touched.argmax(axis=1), touched.shape[1])
        safest = np.lexsort([np.minimum(clearance, OPEN_M).mean(axis=1), until])[-1]
        return plans[safest], until[safest] / 2

    def _clearance(self, row: int, poses: Floats) -> Floats:
        return self._simulator.obstacles(row).approximate_clearance(poses)
