"""n-step transitions against a slow walk through whole episodes, and the replay memory."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dockctl.agents.dqn.replay import Batch, NStep, Replay, Transitions, mirror_every_second
from dockctl.agents.interface import Step
from dockctl.dueling import Mirror

GAMMA = 0.5
"""Powers of one half are exact, so that returns compare exactly."""


def oracle(rewards: list[float], ending: str | None, n: int) -> list[tuple[int, float, float, int]]:
    """(step, return, discount, step of the bootstrap) of each transition of one episode that is ready.

    Observation t is numbered t; an episode of T steps ends in observation T.
    """
    transitions = []
    for t in range(len(rewards)):
        k = min(n, len(rewards) - t)
        if k < n and ending is None:
            continue  # still waiting for rewards
        total = 0.0
        for i in reversed(range(k)):
            total = rewards[t + i] + GAMMA * total
        terminal = ending == "terminated" and t + k == len(rewards)
        transitions.append((t, total, 0.0 if terminal else GAMMA**k, t + k))
    return transitions


episode = st.tuples(
    st.lists(st.integers(-5, 5).map(float), min_size=1, max_size=7),
    st.sampled_from(["terminated", "truncated"]),
)


@settings(max_examples=60, deadline=None)
@given(boats=st.lists(st.lists(episode, min_size=1, max_size=4), min_size=1, max_size=3), n=st.integers(1, 5))
def test_transitions_are_those_of_whole_episodes(boats: list[list[tuple[list[float], str]]], n: int) -> None:
    """Boats with episodes of different lengths; an observation names its boat, episode and step."""
    length = min(sum(len(rewards) for rewards, _ in episodes) for episodes in boats)
    steps: list[list[tuple[tuple[int, int, int], float, bool, bool]]] = []
    expected: Counter[tuple[object, ...]] = Counter()
    for boat, episodes in enumerate(boats):
        own = []
        for number, (rewards, ending) in enumerate(episodes):
            for t, reward in enumerate(rewards):
                last = t == len(rewards) - 1
                is_end = (last and ending == "terminated", last and ending == "truncated")
                own.append(((boat, number, t), reward, *is_end))
        steps.append(own[:length])
        left = length
        for number, (rewards, ending) in enumerate(episodes):
            seen = rewards[:left]
            for t, total, discount, end in oracle(seen, ending if len(seen) == len(rewards) else None, n):
                start, stop = (boat, number, t), (boat, number, end)
                expected[(start, t % 3, total, discount, stop)] += 1
            left = max(0, left - len(rewards))

    n_step, found = NStep(len(boats), n, GAMMA, 3), Counter[tuple[object, ...]]()
    for at in range(length):
        now = [own[at] for own in steps]
        observation = np.array([name for name, *_ in now], float)
        step = Step(
            observation=observation,
            action=np.array([name[2] % 3 for name, *_ in now]),
            reward=np.array([reward for _, reward, _, _ in now]),
            next_observation=observation + [0, 0, 1],
            terminated=np.array([terminated for *_, terminated, _ in now]),
            truncated=np.array([truncated for *_, truncated in now]),
        )
        batch = n_step.add(step)
        for o, a, r, d, following in zip(*batch, strict=True):
            found[(tuple(map(int, o)), int(a), float(r), float(d), tuple(map(int, following)))] += 1
    assert found == expected


def test_by_hand_truncation_bootstraps_and_termination_does_not() -> None:
    for terminated in (True, False):
        n_step = NStep(1, 3, GAMMA, 1)
        end, no = (np.array([terminated]), np.array([not terminated])), np.array([False])
        first = n_step.add(Step(np.array([[0.0]]), np.array([7]), np.array([1.0]), np.array([[1.0]]), no, no))
        assert len(first.action) == 0
        both = n_step.add(Step(np.array([[1.0]]), np.array([8]), np.array([10.0]), np.array([[2.0]]), *end))
        order = np.argsort(both.action)
        np.testing.assert_array_equal(both.action[order], [7, 8])
        np.testing.assert_allclose(both.reward[order], [1 + 0.5 * 10, 10])
        np.testing.assert_allclose(both.discount[order], [0, 0] if terminated else [0.25, 0.5])
        np.testing.assert_array_equal(both.next_observation, [[2], [2]])


def numbered(first: int, count: int) -> Batch:
    values = np.arange(first, first + count, dtype=np.float32)
    return Transitions(
        np.stack([values, -values], 1), values.astype(int), values, values, np.stack([values] * 2, 1)
    )


def test_the_oldest_transitions_are_overwritten() -> None:
    replay = Replay(10, 2, np.random.default_rng(0))
    for first in range(0, 24, 4):
        replay.add(numbered(first, 4))
    assert len(replay) == 10
    batch = replay.sample(1000)
    assert set(batch.action.tolist()) == set(range(14, 24))
    np.testing.assert_array_equal(batch.observation[:, 1], -batch.action)
    assert batch.observation.dtype == batch.reward.dtype == np.float32
    counts = np.bincount(batch.action)[14:]
    assert counts.min() > 60  # uniform: 100 each, give or take


def test_state_round_trip() -> None:
    replay, copy = (Replay(10, 2, np.random.default_rng(5)) for _ in range(2))
    replay.add(numbered(0, 7))
    copy.load(replay.state(), 100)
    for memory in (replay, copy):
        memory.add(numbered(7, 6))
    np.testing.assert_array_equal(replay.sample(50).observation, copy.sample(50).observation)
    with pytest.raises(ValueError, match="action"):
        copy.load(replay.state(), 1)
    with pytest.raises(ValueError, match="replay"):
        Replay(5, 2, np.random.default_rng(0)).load(replay.state(), 100)


def test_every_second_transition_is_mirrored() -> None:
    observation = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9]], np.float32)
    batch = Transitions(
        observation, np.array([0, 1, 2]), np.ones(3), np.ones(3), (observation + 10).astype(np.float32)
    )
    mirror = Mirror(np.array([0, 2, 1]), np.array([-1, 1, 1], np.float32), np.array([2, 1, 0]))
    mirror_every_second(batch, mirror)
    assert batch.observation.tolist() == [[-1, 3, 2], [4, 5, 6], [-7, 9, 8]]
    assert batch.next_observation.tolist() == [[-11, 13, 12], [14, 15, 16], [-17, 19, 18]]
    assert batch.action.tolist() == [2, 1, 0]
    assert (batch.reward == 1).all()
