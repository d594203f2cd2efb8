"""Random sequences of actions for the planner and the safety filter."""

from __future__ import annotations

import numpy as np

from dockctl.geometry import Floats, Ints

LONGEST_SECTION_S, LONGEST_CHANGE_S, LONGEST_SHIFT_S = 8.0, 6.0, 4.0
"""A plan is a random sequence of commands, each held for a random time up to the first, as in sections that
`changes` changes; those of `draw` last up to the second. What follows is shifted by up to the third."""
NEIGHBORS = 8
"""Number of commands that are next to one, as on a grid of forces and angles."""


class RandomPlans:
    """Draws plans, sequences of `steps` actions, and changes of them.

    Args:
        commands: (actions, 2) command of each action [N, rad].
        steps: length of a plan.
        control_period_s: for which an action holds.
    """

    def __init__(self, commands: Floats, steps: int, control_period_s: float) -> None:
        self._actions, self._steps = len(commands), steps
        self._section_steps, self._change_steps, self._shift_steps = (
            max(1, round(time / control_period_s))
            for time in (LONGEST_SECTION_S, LONGEST_CHANGE_S, LONGEST_SHIFT_S)
        )
        levels = np.column_stack([np.unique(column, return_inverse=True)[1] for column in commands.T])
        squared = ((levels[:, None] - levels) ** 2).sum(axis=-1)
        self._near = squared.argsort(axis=1, kind="stable")[:, : 1 + NEIGHBORS]  # first the command itself

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

    def changes(self, rng: np.random.Generator, plans: Ints, until: Ints, count: int) -> Ints:
        """Return changed plans (count, steps), each with one change of one of some plans.

        Either a section has one random command, or in each of its steps a command next to the one before,
        or what follows a step comes earlier or later.

        Args:
            plans: (m, steps).
            until: (m,) number of steps of each in which a change may begin.
        """
        which = rng.integers(len(plans), size=count)
        chosen, step = plans[which], np.arange(self._steps)
        begin = (rng.random(count) * until[which]).astype(np.int64)[:, None]
        end = begin + rng.integers(1, self._section_steps + 1, (count, 1))
        inside = (begin <= step) & (step < end)
        random = np.where(inside, rng.integers(self._actions, size=(count, 1)), chosen)
        neighbor = rng.integers(self._near.shape[1], size=(count, 1))
        near = np.where(inside, self._near[chosen, neighbor], chosen)
        later = rng.choice([-1, 1], (count, 1)) * rng.integers(1, self._shift_steps + 1, (count, 1))
        source = np.clip(step - later * (step >= begin), 0, self._steps - 1)
        shifted = np.take_along_axis(chosen, source, axis=1)
        return np.choose(rng.integers(3, size=(count, 1)), [random, near, shifted])
