"""Random plans: how long commands are held, and that no plan is a copy of another one."""

from __future__ import annotations

import numpy as np
import pytest

from dockctl.control.plans import RandomPlans

ACTIONS, STEPS, COUNT = 77, 30, 1000


@pytest.mark.parametrize("seed", range(3))
def test_commands_are_held_for_uniform_times_and_not_repeated(seed: int) -> None:
    plans = RandomPlans(ACTIONS, STEPS, control_period_s=1.0).draw(np.random.default_rng(seed), COUNT)
    assert plans.shape == (COUNT, STEPS) and set(plans.ravel()) == set(range(ACTIONS))
    changes = (np.diff(plans.ravel()) != 0).mean()
    # Held for 1 to 8 s, 4.5 s on average; one in 77 commands is that of the section before.
    assert changes == pytest.approx((1 - 1 / ACTIONS) / 4.5, rel=0.05)
    windows = np.lib.stride_tricks.sliding_window_view(plans.ravel(), 3 * STEPS)
    assert len(np.unique(windows, axis=0)) == len(windows)


def test_half_of_the_plans_are_changes_of_the_best_one_without_its_first_action() -> None:
    best = np.arange(STEPS)
    plans = RandomPlans(ACTIONS, STEPS, control_period_s=1.0).draw(np.random.default_rng(0), COUNT, best)
    kept = np.append(best[1:], best[-1])
    changed = plans[: COUNT // 2] != kept
    assert np.array_equal(plans[0], kept)
    assert changed.sum(axis=1).max() <= 6
    for row in np.flatnonzero(changed.any(axis=1)):
        first, last = np.flatnonzero(changed[row])[[0, -1]]
        held = plans[row, first : last + 1]
        assert len(set(held[changed[row, first : last + 1]])) == 1
    assert (plans[COUNT // 2 :] != kept).sum() > 0.9 * plans[COUNT // 2 :].size
