"""The safety filter of the planner: the simulator says whether a boat collides with and without it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import default_rng

from dockctl.agents.interface import Policy
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.scenarios.loader import load
from dockctl.sim.starts import given_start, own_site
from tests.control.test_planner import WEATHER
from tests.evaluation.fixed_policies import Values, only
from tests.sim.worlds import walled

POSES = ((20.0, -8.0, 1.2), (14.0, 6.0, 2.0), (22.0, 4.0, -0.6), (25.0, -6.0, 0.3), (18.0, 0.0, 2.9))
"""In the fairway of scenario 3, x, y [m] and heading [rad]."""
STRONG = np.r_[0:14, 63:77]
"""Actions with nearly full thrust."""
FULL_AHEAD = 73
"""50 N, rudder amidships."""


def run(policy: Policy, task: Rollout, *poses: tuple[float, float, float]) -> list[Episode]:
    site = own_site(task.scenario)
    starts = [given_start(site, task.scenario.task, np.array(pose), i) for i, pose in enumerate(poses)]
    return task.run(policy, starts, clearance=False)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_boats_under_full_thrust_are_kept_clear_in_weather(seed: int) -> None:
    rng, outcomes = default_rng(seed), []
    values = np.array([only(action) for action in np.repeat(rng.choice(STRONG, 8), 10).tolist()])
    for planner in (False, True):
        overrides = [WEATHER, f"evaluation.planner={planner}", "task.max_steps=60"]
        task = Rollout(load("s3", overrides=overrides))
        outcomes.append([episode.outcome for episode in run(Values(*values), task, *POSES)])
    assert outcomes[0].count("collision") > 0
    assert "collision" not in outcomes[1]


def test_a_boat_whose_clearance_seems_to_be_zero_moves_away() -> None:
    """As beside a wall: an approximate clearance is zero up to some centimeters."""
    loaded = load("s3", overrides=[WEATHER, "evaluation.planner=true", "task.max_steps=3"])
    (episode,) = run(Values(*[only(FULL_AHEAD)] * 3), Rollout(loaded, [walled(30.0)]), (30.0, -8.0, 0.0))
    assert episode.trajectory["command"][1, 0] < 0


def test_in_open_water_nothing_is_replaced() -> None:
    loaded = load("s3", overrides=[WEATHER, "evaluation.planner=true", "task.max_steps=10"])
    task, values = Rollout(loaded, [walled()]), default_rng(0).random((10, 77))
    (episode,) = run(Values(*values), task, (20.0, 0.0, 2.8))
    expected = loaded.scenario.actions.commands(values.argmax(axis=1), loaded.scenario.vessel)
    np.testing.assert_array_equal(episode.trajectory["command"][1:], expected[: episode.steps])
