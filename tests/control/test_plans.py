"""Random plans: how long commands are held, that no plan is a copy of another one, and what changes."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from dockctl.control.plans import RandomPlans
from dockctl.geometry import Ints

STEPS, COUNT = 30, 1000
PROPELLER_N, RUDDER_DEG = np.linspace(-50, 50, 11), np.linspace(-30, 30, 7)
COMMANDS = np.array([*product(PROPELLER_N, np.radians(RUDDER_DEG))])
ACTIONS = len(COMMANDS)
PLANS = RandomPlans(COMMANDS, STEPS, control_period_s=1.0)


@pytest.mark.parametrize("seed", range(3))
def test_commands_are_held_for_uniform_times_and_not_repeated(seed: int) -> None:
    plans = PLANS.draw(np.random.default_rng(seed), COUNT)
    assert plans.shape == (COUNT, STEPS) and set(plans.ravel()) == set(range(ACTIONS))
    changes = (np.diff(plans.ravel()) != 0).mean()
    # Held for 1 to 8 s, 4.5 s on average; one in 77 commands is that of the section before.
    assert changes == pytest.approx((1 - 1 / ACTIONS) / 4.5, rel=0.05)
    windows = np.lib.stride_tricks.sliding_window_view(plans.ravel(), 3 * STEPS)
    assert len(np.unique(windows, axis=0)) == len(windows)


def test_half_of_the_plans_are_changes_of_the_best_one_without_its_first_action() -> None:
    best = np.arange(STEPS)
    plans = PLANS.draw(np.random.default_rng(0), COUNT, best)
    kept = np.append(best[1:], best[-1])
    changed = plans[: COUNT // 2] != kept
    assert np.array_equal(plans[0], kept)
    assert changed.sum(axis=1).max() <= 6
    for row in np.flatnonzero(changed.any(axis=1)):
        first, last = np.flatnonzero(changed[row])[[0, -1]]
        held = plans[row, first : last + 1]
        assert len(set(held[changed[row, first : last + 1]])) == 1
    assert (plans[COUNT // 2 :] != kept).sum() > 0.9 * plans[COUNT // 2 :].size


def test_a_change_is_a_section_of_one_command_or_of_neighbors_or_a_shift() -> None:
    rng = np.random.default_rng(0)
    before, until = rng.integers(ACTIONS, size=(1, STEPS)), 20
    levels = np.array([*product(range(11), range(7))])
    changed = PLANS.changes(rng, before, np.array([until]), COUNT)
    kinds = {"same": 0, "one": 0, "neighbors": 0, "shifted": 0}
    for plan in changed:
        where = np.flatnonzero(plan != before[0])
        if len(where) == 0:
            kinds["same"] += 1
            continue
        first, last = where[[0, -1]]
        section = plan[first : last + 1]
        assert first < until + 4  # after a shift the first step that follows may be the same
        apart = np.abs(levels[section] - levels[before[0, first : last + 1]])
        if any(_follows(plan, before[0], by) for by in (-4, -3, -2, -1, 1, 2, 3, 4)):
            kinds["shifted"] += 1
        elif apart.max() <= 2 and len(section) <= 8:  # at the edge of the grid two levels away
            kinds["neighbors"] += 1
        else:
            assert len(set(section.tolist())) == 1 and len(section) <= 8
            kinds["one"] += 1
    assert kinds["same"] < 0.1 * COUNT
    assert all(0.25 * COUNT < kinds[kind] < 0.42 * COUNT for kind in ("one", "neighbors", "shifted")), kinds


def _follows(plan: Ints, before: Ints, by: int) -> bool:
    """Return whether a plan is another one up to a step, and from there on this one `by` steps later."""
    step = np.arange(len(plan))
    shifted = before[np.clip(step - by, 0, len(plan) - 1)]
    return any((plan == np.where(step >= begin, shifted, before)).all() for begin in step)


def test_changes_are_of_all_given_plans() -> None:
    rng = np.random.default_rng(1)
    given = np.repeat(rng.integers(ACTIONS, size=(4, 1)), STEPS, axis=1)
    changed = PLANS.changes(rng, given, np.full(4, STEPS), COUNT)
    nearest = (changed[:, None] == given).sum(axis=2).argmax(axis=1)
    assert np.bincount(nearest, minlength=4).min() > 0.2 * COUNT
