"""Random starts: within their bounds, free, at their own site, and the same for any number of starts."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dockctl.errors import DockctlError
from dockctl.evaluation import starts as drawn
from dockctl.evaluation.rollout import Rollout
from dockctl.evaluation.starts import random_starts
from dockctl.geometry import Floats
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import own_site, sites
from tests.evaluation.fixed_policies import Rest
from tests.sim.worlds import walled

S1, MARINA = load("s1").scenario, load("marina").scenario
OPEN = [walled()] * 5


def test_they_are_bounded_free_and_do_not_depend_on_their_number() -> None:
    def draw(episodes: int, seed: int) -> Floats:
        starts = random_starts(S1, [own_site(S1)], [walled(20.5)], episodes=episodes, seed=seed)
        assert {start.kind for start in starts} == {"random"}
        return np.stack([start.eta for start in starts])

    many = draw(50, 3)
    around = S1.evaluation.random_starts
    reach = [around.position_m, around.position_m, math.radians(around.heading_deg)]
    farthest = np.abs(many - [20, 2, math.radians(160)]).max(axis=0)
    assert (0.9 * np.array(reach) < farthest).all() and (farthest <= reach).all()
    assert (many[:, 0] <= 20.5).all()
    assert np.array_equal(draw(5, 3), many[:5])
    assert not np.array_equal(draw(5, 4), many[:5])


@pytest.mark.parametrize(("episodes", "seed"), [(-1, 0), (1, -1)])
def test_negative_numbers_are_an_error(episodes: int, seed: int) -> None:
    with pytest.raises(DockctlError) as caught:
        drawn.testing_starts(S1, OPEN, episodes, seed)
    assert caught.value.code == "out_of_range"


def test_a_negative_seed_of_the_starts_at_trained_berths_is_an_error() -> None:
    with pytest.raises(DockctlError) as caught:
        drawn.evaluation_starts(MARINA, OPEN, -1)
    assert caught.value.code == "out_of_range"


def test_the_seed_draws_the_starts_at_trained_berths() -> None:
    own, seeds = MARINA.evaluation.random_starts.seed, (None, MARINA.evaluation.random_starts.seed, 7)
    starts = [[start.eta.tolist() for start in drawn.evaluation_starts(MARINA, OPEN, seed)] for seed in seeds]
    assert starts[0] == starts[1] != starts[2] and own != 7


@pytest.mark.parametrize("scenario", [S1, MARINA])
def test_validation_starts_differ_from_those_of_an_evaluation(scenario: Scenario) -> None:
    """They are many, bounded like test starts, at trained berths, and the same for every training seed."""
    selecting = drawn.validation_starts(scenario, OPEN)
    assert len(selecting) == 100
    tests = drawn.testing_starts(scenario, OPEN, 1000, scenario.evaluation.random_starts.seed)
    others = np.stack([start.eta for start in [*drawn.evaluation_starts(scenario, OPEN), *tests]])
    nearest = [np.abs(others - start.eta).max(axis=1).min() for start in selecting]
    assert min(nearest) > 0
    trained = {site.berth: site.initial for site in sites(scenario) if site.kind != "held_out"}
    around = scenario.evaluation.random_starts
    reach = [around.position_m, around.position_m, math.radians(around.heading_deg)]
    for start in selecting:
        assert (np.abs(start.eta - trained[start.berth]) <= reach).all(axis=1).any()
    seeds = {start.seed for start in selecting}
    assert len(seeds) == 100 and seeds.isdisjoint({None, *range(1000)})  # tests have their number
    training = scenario.training.model_copy(update={"seed": 7})
    again = drawn.validation_starts(scenario.model_copy(update={"training": training}), OPEN)
    assert all(np.array_equal(a.eta, b.eta) for a, b in zip(selecting, again, strict=True))


@pytest.mark.parametrize("steps", [3, 700])
def test_evaluations_have_their_own_step_limit(steps: int) -> None:
    for name in ("s1", "marina"):
        loaded = load(name, overrides=[f"evaluation.max_steps={steps}"])
        scenario, pose = loaded.scenario, loaded.scenario.task.initial[0]
        chosen = (
            drawn.evaluation_starts,
            drawn.validation_starts,
            drawn.trajectory_starts,
            drawn.training_starts,
        )
        starts = [*drawn.testing_starts(scenario, OPEN, 2, 0), *drawn.checked_starts(loaded, [pose])]
        starts += [start for choose in chosen for start in choose(scenario, OPEN)]
        assert {start.max_steps for start in starts} == {steps}
        assert scenario.in_training().task.max_steps == load(name).scenario.in_training().task.max_steps
    loaded = load("s1", overrides=[f"evaluation.max_steps={steps}"])
    episode = Rollout(loaded, [walled()]).run(Rest(), drawn.evaluation_starts(loaded.scenario, OPEN))[0]
    assert (episode.outcome, episode.steps) == ("timeout", steps)


def test_they_are_around_their_own_site() -> None:
    held_out = [site for site in sites(MARINA) if site.kind == "held_out"]
    around = {site.berth: site.initial[0] for site in held_out}
    starts = random_starts(MARINA, held_out, OPEN, episodes=200, seed=1, kind="held_out")
    assert {start.berth for start in starts} == set(around)
    for start in starts:
        off = start.eta - around[start.berth]
        assert (np.abs(off) <= [3, 3, math.radians(20)]).all()


def test_the_intermediate_pose_is_nominal_unless_it_is_drawn() -> None:
    nominal = {site.berth: site.goals for site in sites(MARINA)}
    starts = random_starts(MARINA, sites(MARINA), OPEN, episodes=20, seed=1)
    assert all(np.array_equal(start.goals, nominal[start.berth]) for start in starts)
    drawn = random_starts(MARINA, sites(MARINA), OPEN, episodes=20, seed=1, spread=True)
    assert not any(np.array_equal(start.goals[0], nominal[start.berth][0]) for start in drawn)
