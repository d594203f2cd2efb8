"""Returns of behaviors in open water against sums by hand, and the break-even of the intermediate pose."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd
import pytest

from dockctl.analysis.returns import AT_START, BEFORE_INTERMEDIATE, DOCKING, break_even
from dockctl.evaluation.returns import (
    Behavior,
    BehaviorSimulation,
    discounted,
    evaluate_behaviors,
    loiter_before_intermediate,
    returns,
)
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import given_start, own_site
from tests.sim.worlds import walled

GAMMA = 0.99
NOTHING = np.zeros((1, 2))


def simulation(
    scenario: Scenario, pose: tuple[float, float, float] | None = None, wall_m: float = np.inf
) -> BehaviorSimulation:
    site = own_site(scenario)
    at = site.initial[0] if pose is None else np.array(pose)
    return BehaviorSimulation(scenario, [walled(wall_m)], given_start(site, scenario.task, at, 0))


def table(scenario: Scenario, unit_m: float, *behaviors: Behavior) -> pd.DataFrame:
    return pd.DataFrame(evaluate_behaviors(scenario, unit_m, behaviors))


def test_a_discounted_sum() -> None:
    assert discounted([1.0, 2.0, 4.0], 0.5) == 1 + 1 + 1
    assert discounted([3.0], 0.0) == 3
    assert discounted([], 0.9) == 0


@pytest.mark.parametrize(("unit_m", "each"), [(20.0, -155.84), (1.0, -2453.58)])
def test_waiting_at_the_start_is_a_geometric_sum(unit_m: float, each: float) -> None:
    scenario = load("s1").scenario
    waiting = simulation(scenario).run(AT_START, NOTHING)
    assert (waiting.outcome, len(waiting.statuses)) == ("timeout", 500)
    row = table(scenario, unit_m, waiting).iloc[0]
    assert row["return"] == pytest.approx(each * (1 - GAMMA**500) / (1 - GAMMA), rel=1e-4)
    assert row["reward_speed"] == row["reward_final"] == row["reward_collision"] == 0


def test_a_collision_has_no_other_reward_in_its_step() -> None:
    scenario = load("s1").scenario
    behavior = simulation(scenario, (20.0, 2.0, math.pi), wall_m=21.0).run("astern", np.array([[-50.0, 0.0]]))
    steps = len(behavior.statuses)
    assert behavior.outcome == "collision" and 5 < steps < 50
    row = table(scenario, 20.0, behavior).iloc[0]
    assert row["reward_collision"] == pytest.approx(-30_000 * GAMMA ** (steps - 1))
    distances = [status.distance_m[0] for status in behavior.statuses[:-1]]
    by_hand = sum(-150 * d / 20 * GAMMA**t for t, d in enumerate(distances))
    assert row["reward_distance"] == pytest.approx(by_hand)
    assert row["return"] == pytest.approx(sum(row[name] for name in row.index if name.startswith("reward_")))


def test_the_returns_are_those_of_the_training() -> None:
    """In s1 a command lasts 0.5 s, in its training 1 s, and there each step is discounted."""
    scenario = load("s1").scenario
    assert (scenario.vessel.control_period_s, scenario.training.action_repeat) == (0.5, 2)
    row = returns("s1", units_m=[20.0]).table.iloc[0]
    assert (row["behavior"], row["outcome"]) == (DOCKING, "docked")
    assert row["steps"] == row["time_s"] > 30
    assert row["reward_final"] == pytest.approx(30_000 * GAMMA ** (row["steps"] - 1), rel=1e-5)


def through_the_intermediate_pose(scenario: Scenario) -> tuple[BehaviorSimulation, np.ndarray, Behavior]:
    """Return a simulation that starts 4 m before the intermediate pose, and commands that stop there."""
    pose = scenario.task.intermediate
    assert pose is not None
    heading = math.radians(pose.heading_deg)
    before = (pose.x_m - 4 * math.cos(heading), pose.y_m - 4 * math.sin(heading), heading)
    commands = np.concatenate([np.tile([50.0, 0.0], (19, 1)), np.zeros((6, 2))])
    approach = simulation(scenario, before)
    return approach, commands, approach.run(DOCKING, commands)


@pytest.mark.thorough
def test_loitering_stops_just_before_the_intermediate_pose_is_reached() -> None:
    scenario = load("s3").scenario
    approach, commands, reaching = through_the_intermediate_pose(scenario)
    assert reaching.intermediate_step is not None
    loitering = loiter_before_intermediate(approach, commands, reaching.intermediate_step)
    assert loitering is not None
    assert (loitering.intermediate_step, loitering.outcome, len(loitering.statuses)) == (None, "timeout", 500)
    tolerance = scenario.task.intermediate_tolerance.distance_m
    assert tolerance < loitering.statuses[-1].distance_m[0] < tolerance + 0.4
    pushed = next(i for i, status in enumerate(loitering.statuses) if not status.command.any())
    longer = np.concatenate([commands[: pushed + 1], NOTHING])
    assert approach.run("a step longer", longer).intermediate_step is not None


def test_a_boat_that_drifts_through_the_pose_cannot_loiter_before_it() -> None:
    scenario = load("s3").scenario
    pose = scenario.task.intermediate
    assert pose is not None
    inside = simulation(scenario, (pose.x_m, pose.y_m, math.radians(pose.heading_deg)))
    reaching = inside.run(DOCKING, NOTHING)
    assert reaching.intermediate_step == 0
    assert loiter_before_intermediate(inside, NOTHING, reaching.intermediate_step) is None


@pytest.mark.parametrize("unit_m", [20.0, pytest.param(1.0, marks=pytest.mark.thorough)])
def test_docking_and_loitering_have_equal_returns_at_break_even(unit_m: float) -> None:
    scenario = load("s3").scenario
    approach, commands, reaching = through_the_intermediate_pose(scenario)
    assert reaching.intermediate_step is not None
    loitering = loiter_before_intermediate(approach, commands, reaching.intermediate_step)
    assert loitering is not None
    least = break_even(table(scenario, unit_m, reaching, loitering))
    assert least is not None
    row = table(scenario, unit_m, reaching).iloc[0]
    assert row["intermediate_discount"] == pytest.approx(GAMMA**reaching.intermediate_step)
    terms = tuple(
        term.model_copy(update={"weight": least}) if term.term == "intermediate" else term
        for term in scenario.reward.terms
    )
    reward = scenario.reward.model_copy(update={"terms": terms})
    even = table(scenario.model_copy(update={"reward": reward}), unit_m, reaching, loitering)
    assert even["behavior"].tolist() == [DOCKING, BEFORE_INTERMEDIATE]
    assert even["return"][0] == pytest.approx(even["return"][1])


def test_without_an_intermediate_pose_there_is_no_break_even() -> None:
    scenario = load("s1").scenario
    rows = table(scenario, 20.0, simulation(scenario).run(DOCKING, NOTHING))
    assert rows["intermediate_discount"].tolist() == [0.0]
    assert break_even(rows) is None
