"""Random sequences of actions for the planner and the safety filter."""

from __future__ import annotations

import numpy as np

from dockctl.geometry import Ints

LONGEST_SECTION_S, LONGEST_CHANGE_S = 8.0, 6.0
"""A plan is a random sequence of commands, each held for a random time up to this; so is a change of it."""


class RandomPlans:
    """Draws plans, sequences of `steps` actions, of which half are changes of the best one so far.

    Args:
        actions: number of actions.
        steps: length of a plan.
        control_period_s: for which an action holds.
    """

    def __init__(self, actions: int, steps: int, control_period_s: float) -> None:
        self._actions, self._steps = actions, steps
        self._section_steps, self._change_steps = (
            max(1, round(time / control_period_s)) for time in (LONGEST_SECTION_S, LONGEST_CHANGE_S)
        )

    def draw(self, rng: np.random.Generator, count: int, best: Ints | None = None) -> Ints:
        """Return plans (count, steps).

        Args:
            best: the best plan of the control step before (steps,); half of the plans are changes of it,
                without its first action.
        """
        mean_steps = (1 + self._section_steps) / 2
        sections = round(1.1 * count * self._steps / mean_steps) + 50  # more than are needed
        chosen = rng.integers(self._actions, size=sections)
        held = rng.integers(1, self._section_steps + 1, len(chosen))
        plans: Ints = np.repeat(chosen, held)[: count * self._steps].reshape(count, self._steps)
        if best is not None:
            changed, kept = count // 2, np.append(best[1:], best[-1])
            begin = rng.integers(self._steps, size=(changed, 1))
            end = begin + rng.integers(1, self._change_steps + 1, (changed, 1))
            end[0] = begin[0]  # the best plan itself
            inside = (begin <= np.arange(self._steps)) & (np.arange(self._steps) < end)
            plans[:changed] = np.where(inside, rng.integers(self._actions, size=(changed, 1)), kept)
        return plans
