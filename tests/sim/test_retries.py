"""Retried starts: which are kept, how often they are taken, and in training environments."""

from __future__ import annotations

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.sim.checks import load_checked
from dockctl.sim.retries import KEPT, FailedStarts
from dockctl.sim.starts import Start

BOTH = np.array([True, True])


def start(number: float, kind: str = "pose") -> Start:
    return Start(np.array([number, 0, 0]), np.zeros(3), 1, np.zeros((2, 3)), 50, kind, 0)


def begin(failed: FailedStarts, *starts: Start) -> None:
    failed.begin(np.arange(2), starts)


def test_the_oldest_failed_start_of_the_boat_is_taken_once() -> None:
    failed, rng = FailedStarts(2, 1.0), np.random.default_rng(0)
    for number in (1.0, 2.0):
        begin(failed, start(number), start(-number))
        failed.end(np.array([True, number > 1]))
    taken = [failed.take(0, rng), failed.take(0, rng), failed.take(0, rng)]
    assert [None if s is None else (s.eta[0], s.kind) for s in taken] == [
        (1, "retried"),
        (2, "retried"),
        None,
    ]
    other = failed.take(1, rng)
    assert other is not None and other.eta[0] == -2
    assert failed.take(1, rng) is None


def test_docked_and_exploring_episodes_are_not_retried() -> None:
    failed = FailedStarts(2, 1.0)
    begin(failed, start(1), start(2, "exploring"))
    failed.end(np.array([False, True]))
    assert [failed.take(boat, np.random.default_rng(0)) for boat in (0, 1)] == [None, None]


def test_retries_are_as_frequent_as_their_fraction() -> None:
    failed, rng = FailedStarts(2, 0.3), np.random.default_rng(0)
    taken = 0
    for _ in range(4000):  # every episode of boat 0 fails
        retried = failed.take(0, rng)
        taken += retried is not None
        begin(failed, retried or start(1), start(2))
        failed.end(np.array([True, False]))
    assert taken / 4000 == pytest.approx(0.3, abs=4 * np.sqrt(0.21 / 4000))


def test_of_many_failed_starts_the_latest_are_kept() -> None:
    failed, rng = FailedStarts(2, 1.0), np.random.default_rng(0)
    for number in range(KEPT + 5):
        begin(failed, start(number), start(0))
        failed.end(BOTH)
    kept = iter(lambda: failed.take(0, rng), None)
    assert [s.eta[0] for s in kept if s is not None] == list(range(5, KEPT + 5))


def test_an_environment_retries_the_starts_of_failed_episodes_only_in_training() -> None:
    overrides = (
        "training.retried_starts={fraction: 1}", "training.exploring_starts=null", "task.max_steps=3",
        "task.initial=[{x_m: 20, y_m: 2, heading_deg: 160, position_offset_m: 1}]",
    )  # fmt: skip
    loaded = load_checked("s1", overrides=overrides)
    for exploring in (True, False):
        env = DockingVectorEnv(loaded, 2, exploring=exploring)
        _, info = env.reset(seed=0)
        first, kinds = info["pose"].copy(), []
        for _ in range(2):
            for _ in range(3):  # all episodes time out
                _, _, _, truncated, info = env.step(np.array([38, 38]))
            assert truncated.all()
            kinds.append(set(info["start_kind"]))
            assert np.array_equal(info["pose"], first) == exploring
        assert kinds == [{"retried" if exploring else "pose"}] * 2


def test_the_state_of_another_number_of_boats_is_refused() -> None:
    with pytest.raises(ValueError, match="boats"):
        FailedStarts(2, 0.3).restore(FailedStarts(3, 0.3).state())
