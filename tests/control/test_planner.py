"""The planner, with a policy that does nothing: all that docks is a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dockctl.control.planner import CHANGES, RANDOM, ROUNDS, Planner
from dockctl.evaluation import rollout
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import PolicyInterface
from dockctl.sim.goal import TO_FINAL
from dockctl.sim.simulator import Simulator
from dockctl.sim.starts import Start, given_start, own_site
from tests.evaluation.fixed_policies import Rest

WEATHER = (
    "conditions={wind: {speed_mps: 3, direction_deg: 90}, current: {speed_mps: 0.05, direction_deg: 200},"
    " navigation: {velocity_mps: 0.02}, actuators: {delay_steps: 1}}"
)
AWAY_M = ((3.0, 0.3, 0.1), (2.5, -0.4, -0.2), (4.0, 0.0, 0.3))
FARTHER_M = ((6.8, 0.6, 0.4), (6.6, -0.6, -0.3), (6.8, 0.0, 0.5), (6.6, 0.5, -0.4))
"""Distance before the final pose of scenario 1, to the side of it, and heading error [rad]."""


def task(*overrides: str) -> Rollout:
    return Rollout(load("s1", overrides=["task.max_steps=100", WEATHER, *overrides]))


def starts(given: Rollout, away: Sequence[tuple[float, float, float]] = AWAY_M) -> list[Start]:
    site = own_site(given.scenario)
    x, y, heading = site.goals[1]
    poses = [(x + np.cos(heading) * ahead, y + side, heading + turn) for ahead, side, turn in away]
    begun = [given_start(site, given.scenario.task, np.array(pose), i) for i, pose in enumerate(poses)]
    return [replace(start, phase=TO_FINAL) for start in begun]


def run(*overrides: str) -> list[Episode]:
    given = task(*overrides)
    return given.run(Rest(), starts(given))


@pytest.mark.slow
def test_a_plan_docks_in_weather_without_contact() -> None:
    assert "docked" not in {episode.outcome for episode in run()}
    landed = run("evaluation.planner=true")
    assert [episode.outcome for episode in landed] == ["docked"] * 3
    assert min(episode.clearance_m for episode in landed if episode.clearance_m is not None) > 0


@pytest.mark.slow
def test_an_episode_does_not_depend_on_those_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for boats in (1, 3):
        monkeypatch.setattr(rollout, "PARALLEL_BOATS", boats)
        found.append([e.trajectory["command"] for e in run("evaluation.planner=true", "task.max_steps=6")])
    for together, alone in zip(*found, strict=True):
        np.testing.assert_array_equal(together, alone)
    assert any(command[1:].any() for command in found[0])


def test_far_from_the_final_pose_the_policy_acts() -> None:
    given = task("evaluation.planner=true", "task.max_steps=5")
    site = own_site(given.scenario)
    start = given_start(site, given.scenario.task, site.initial[0], 0)
    (episode,) = given.run(Rest(), [start], clearance=False)
    assert not episode.trajectory["command"].any()


@pytest.mark.parametrize(
    ("before_m", "error_m", "later_s", "plans"),
    [(7.5, 1.0, 120, 1), (6.5, -1.0, 120, 0), (14.5, 0, 120, 0), (14.5, 0, 0, 1), (15.5, 0, 0, 0)],
)
def test_the_measured_distance_decides_whether_to_plan(
    monkeypatch: pytest.MonkeyPatch, before_m: float, error_m: float, later_s: float, plans: int
) -> None:
    """The final pose of scenario 1 is (36, 0, 180°); plans begin within 7 m, and later within 15 m."""
    planned: list[int] = []
    monkeypatch.setattr("dockctl.control.planner.LATER_S", later_s)
    monkeypatch.setattr(Planner, "_planned", lambda self, row, pose, kept: planned.append(row))
    monkeypatch.setattr(Simulator, "measured_pose", lambda self: self.eta + [error_m, 0, 0])
    given = task("evaluation.planner=true", "task.max_steps=1")
    pose = np.array([36 - before_m, 0, np.pi])
    start = given_start(own_site(given.scenario), given.scenario.task, pose, 0)
    given.run(Rest(), [replace(start, phase=TO_FINAL)], clearance=False)
    assert len(planned) == plans


def needed(monkeypatch: pytest.MonkeyPatch, *, random: int, rounds: int) -> list[float]:
    """Return the share of the limits that the best plan needs in the first step of each of some starts."""
    found: list[float] = []
    planned = Planner._planned

    def recorded(self: Planner, row: int, *arguments: Any) -> int | None:
        action = planned(self, row, *arguments)
        found.append(float(self._best[row].needed[0]))
        return action

    monkeypatch.setattr("dockctl.control.planner.RANDOM", random)
    monkeypatch.setattr("dockctl.control.planner.ROUNDS", rounds)
    monkeypatch.setattr(Planner, "_planned", recorded)
    given = task("evaluation.planner=true", "task.max_steps=1")
    given.run(Rest(), starts(given, FARTHER_M), clearance=False)
    monkeypatch.undo()
    return found


@pytest.mark.slow
def test_changes_find_better_plans_than_as_many_random_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    changed = needed(monkeypatch, random=RANDOM, rounds=ROUNDS)
    chosen = needed(monkeypatch, random=RANDOM + ROUNDS * CHANGES, rounds=0)
    assert len(changed) == len(FARTHER_M) and np.mean(changed) < 0.9 * np.mean(chosen), (changed, chosen)


def test_a_policy_keeps_its_planner() -> None:
    planned = load("s1", overrides=["evaluation.planner=true"]).scenario
    interface = PolicyInterface.of(planned)
    assert interface.on(load("s2").scenario).evaluation.planner is True
    without = load("s2", overrides=["evaluation.planner=false"]).scenario
    assert interface.on(without).evaluation.planner is False
    assert interface.agrees(planned, load("s1").scenario)
