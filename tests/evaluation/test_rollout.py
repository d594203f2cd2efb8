"""Greedy episodes: order, refilling, what they record, and what is made of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from dockctl.analysis.episodes import ending, summarize, wilson_interval
from dockctl.evaluation.rollout import Episode, play, score
from tests.agents.toy import ToyDocking, starts_at


class BrakeAtZero:
    """Drive at 0.1 a step and stop in reach of zero; from 0.4 on run into the wall."""

    def reset(self, rows: np.ndarray, info: dict[str, Any]) -> None:
        pass

    def act(self, observation: np.ndarray, info: dict[str, Any]) -> np.ndarray:
        x, u = observation.T
        wanted = np.where(x > 0.35, 0.3, np.where(np.abs(x) < 0.12, 0.0, 0.1))
        return np.sign((wanted - u).round(3)).astype(int) + 1


@pytest.mark.parametrize("boats", [1, 2, 3, 7])
def test_episodes_are_the_same_however_many_boats_play_them(boats: int) -> None:
    starts = starts_at(-0.95, 0.45, -0.55, -1.35, 0.4)
    episodes = play(
        ToyDocking(boats), BrakeAtZero(), starts, clearance=lambda start, way: float((0.5 - way[:, 0]).min())
    )
    assert [e.outcome for e in episodes] == ["docked", "collision", "docked", "docked", "collision"]
    assert [e.collided_with for e in episodes] == ["", "wall", "", "", "wall"]
    alone = [play(ToyDocking(1), BrakeAtZero(), starts[i : i + 1])[0] for i in range(len(starts))]
    for together, single, start in zip(episodes, alone, starts, strict=True):
        assert together.start is start
        assert together.total_reward == single.total_reward
        for key, values in single.course.items():
            np.testing.assert_array_equal(together.course[key], values)


def test_what_an_episode_records() -> None:
    (episode,) = play(ToyDocking(1), BrakeAtZero(), starts_at(-0.35))
    np.testing.assert_allclose(episode.course["pose"][:, 0], [-0.35, -0.25, -0.15, -0.05, -0.05], atol=1e-12)
    np.testing.assert_allclose(episode.course["command"][:, 0], [0, 0.1, 0, 0, -0.1], atol=1e-12)
    assert episode.steps == 4
    assert episode.path_length_m == pytest.approx(0.3)
    assert episode.control_changes == pytest.approx(2 / 3)
    row = episode.row()
    assert row["clearance_m"] is None
    assert row["distance_m"] == pytest.approx(0.05)
    assert row["return"] == pytest.approx(10 - 0.25 - 0.15 - 0.05)


def episode(outcome: str, steps: int, phase: int = 1, what: str = "", clearance: float = 1.0) -> Episode:
    course = {
        "pose": np.stack([np.arange(steps + 1.0), np.zeros(steps + 1), np.zeros(steps + 1)], 1),
        "velocity": np.full((steps + 1, 3), 0.3),
        "command": np.zeros((steps + 1, 2)),
        "distance_m": np.full(steps + 1, 0.5),
        "heading_error_rad": np.full(steps + 1, -0.1),
        "reward": np.ones(steps + 1),
    }
    return Episode(starts_at(0.0)[0], outcome, what, phase, float(steps), course, clearance)


def test_summary() -> None:
    played = [
        episode("docked", 10),
        episode("docked", 20, clearance=0.4),
        episode("collision", 5, what="moored 3", clearance=0.0),
        episode("timeout", 30, phase=0),
    ]
    summary = summarize(played, 0.5)
    assert (summary["docked"], summary["episodes"], summary["success"]) == (2, 4, 0.5)
    assert summary["endings"] == {"docked": 2, "collision with moored 3": 1, "timeout in phase 0": 1}
    assert summary["least_clearance_m"] == 0.0
    means = summary["mean_of_docked"]
    assert (means["steps"], means["time_s"], means["path_length_m"]) == (15, 7.5, 15)
    assert means["heading_error_deg"] == pytest.approx(np.degrees(0.1))
    assert summarize(played[2:], 0.5)["mean_of_docked"] is None
    assert score(played) == (2, 16.25)
    assert ending(episode("collision", 1)) == "collision with the harbor"


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (95, 100), (0, 20), (7, 13)])
def test_wilson_interval_is_that_of_scipy(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-6)


def test_wilson_interval_of_nothing() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)
