"""``dockctl returns``: behaviors in open water against sums by hand, and the break-even of the gate."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dockctl.analysis.returns import AT_START, BEFORE_INTERMEDIATE, DOCKING, break_even
from dockctl.commands.returns import units_of
from dockctl.errors import DockctlError
from dockctl.evaluation.returns import (
    Behavior,
    Stage,
    discounted,
    evaluate_behaviors,
    loiter_before_intermediate,
)
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import given_start, own_site
from tests.commands.conftest import Outcome, dockctl
from tests.sim.worlds import walled

GAMMA = 0.99
NOTHING = np.zeros((1, 2))


def water(
    scenario: Scenario, pose: tuple[float, float, float] | None = None, wall_m: float = np.inf
) -> Stage:
    site = own_site(scenario)
    at = site.initial[0] if pose is None else np.array(pose)
    return Stage(scenario, [walled(wall_m)], given_start(site, scenario.task, at, 0))


def judged(scenario: Scenario, unit_m: float, *behaviors: Behavior) -> pd.DataFrame:
    return pd.DataFrame(evaluate_behaviors(scenario, unit_m, behaviors))


def test_a_discounted_sum() -> None:
    assert discounted([1.0, 2.0, 4.0], 0.5) == 1 + 1 + 1
    assert discounted([3.0], 0.0) == 3
    assert discounted([], 0.9) == 0


@pytest.mark.parametrize(("unit_m", "each"), [(20.0, -155.84), (1.0, -2453.58)])
def test_waiting_at_the_start_is_a_geometric_sum(unit_m: float, each: float) -> None:
    scenario = load("s1").scenario
    waiting = water(scenario).play(AT_START, NOTHING)
    assert (waiting.outcome, len(waiting.statuses)) == ("timeout", 500)
    row = judged(scenario, unit_m, waiting).iloc[0]
    assert row["return"] == pytest.approx(each * (1 - GAMMA**500) / (1 - GAMMA), rel=1e-4)
    assert row["reward_speed"] == row["reward_final"] == row["reward_collision"] == 0


def test_the_step_that_hits_something_pays_for_the_collision_alone() -> None:
    scenario = load("s1").scenario
    behavior = water(scenario, (20.0, 2.0, math.pi), wall_m=21.0).play("astern", np.array([[-50.0, 0.0]]))
    steps = len(behavior.statuses)
    assert behavior.outcome == "collision" and 5 < steps < 50
    row = judged(scenario, 20.0, behavior).iloc[0]
    assert row["reward_collision"] == pytest.approx(-30_000 * GAMMA ** (steps - 1))
    distances = [status.distance_m[0] for status in behavior.statuses[:-1]]
    by_hand = sum(-150 * d / 20 * GAMMA**t for t, d in enumerate(distances))
    assert row["reward_distance"] == pytest.approx(by_hand)
    assert row["return"] == pytest.approx(sum(row[name] for name in row.index if name.startswith("reward_")))


def through_the_gate(scenario: Scenario) -> tuple[Stage, np.ndarray, Behavior]:
    """Ahead towards the gate from 4 m before it, stop there, and astern: a way that opens the gate."""
    gate = scenario.task.intermediate
    assert gate is not None
    heading = math.radians(gate.heading_deg)
    before = (gate.x_m - 4 * math.cos(heading), gate.y_m - 4 * math.sin(heading), heading)
    course = np.concatenate([np.tile([50.0, 0.0], (19, 1)), np.zeros((6, 2))])
    there = water(scenario, before)
    return there, course, there.play(DOCKING, course)


def test_loitering_stops_just_too_soon_to_open_the_gate() -> None:
    scenario = load("s3").scenario
    there, course, opening = through_the_gate(scenario)
    assert opening.intermediate_step is not None
    loitering = loiter_before_intermediate(there, course, opening.intermediate_step)
    assert loitering is not None
    assert (loitering.intermediate_step, loitering.outcome, len(loitering.statuses)) == (None, "timeout", 500)
    tolerance = scenario.task.intermediate_tolerance.distance_m
    assert tolerance < loitering.statuses[-1].distance_m[0] < tolerance + 0.4
    pushed = next(i for i, status in enumerate(loitering.statuses) if not status.command.any())
    longer = np.concatenate([course[: pushed + 1], NOTHING])
    assert there.play("a step longer", longer).intermediate_step is not None


def test_a_boat_that_drifts_through_the_gate_cannot_loiter_at_it() -> None:
    scenario = load("s3").scenario
    gate = scenario.task.intermediate
    assert gate is not None
    inside = water(scenario, (gate.x_m, gate.y_m, math.radians(gate.heading_deg)))
    opening = inside.play(DOCKING, NOTHING)
    assert opening.intermediate_step == 0
    assert loiter_before_intermediate(inside, NOTHING, opening.intermediate_step) is None


@pytest.mark.parametrize("unit_m", [20.0, 1.0])
def test_at_break_even_docking_is_worth_what_loitering_is(unit_m: float) -> None:
    scenario = load("s3").scenario
    there, course, opening = through_the_gate(scenario)
    assert opening.intermediate_step is not None
    loitering = loiter_before_intermediate(there, course, opening.intermediate_step)
    assert loitering is not None
    least = break_even(judged(scenario, unit_m, opening, loitering))
    assert least is not None
    row = judged(scenario, unit_m, opening).iloc[0]
    assert row["intermediate_discount"] == pytest.approx(GAMMA**opening.intermediate_step)
    terms = tuple(
        term.model_copy(update={"weight": least}) if term.term == "intermediate" else term
        for term in scenario.reward.terms
    )
    reward = scenario.reward.model_copy(update={"terms": terms})
    even = judged(scenario.model_copy(update={"reward": reward}), unit_m, opening, loitering)
    assert even["behavior"].tolist() == [DOCKING, BEFORE_INTERMEDIATE]
    assert even["return"][0] == pytest.approx(even["return"][1])


def test_without_a_gate_there_is_no_break_even() -> None:
    scenario = load("s1").scenario
    rows = judged(scenario, 20.0, water(scenario).play(DOCKING, NOTHING))
    assert rows["intermediate_discount"].tolist() == [0.0]
    assert break_even(rows) is None


def test_units_of() -> None:
    assert units_of("20, 1") == (20.0, 1.0)
    for wrong in ("", "20,", "20,20", "0", "-1", "nan", "inf", "meters"):
        with pytest.raises(DockctlError):
            units_of(wrong)


def test_a_policy_that_does_not_dock_is_told(trained: tuple[Path, Outcome], tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained[0], run)
    outcome = dockctl("returns", "--ckpt", run)
    assert outcome.code == 2
    assert outcome.error_code == "mismatch"
    assert not (run / "returns.csv").exists()
