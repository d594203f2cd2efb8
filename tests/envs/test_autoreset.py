"""The step in which an episode ends: autoreset modes, compared with Gymnasium's own vector environment."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import vector

from dockctl.envs.single import DockingEnv
from dockctl.envs.vector import DockingVectorEnv
from dockctl.scenarios.loader import LoadedScenario, load
from tests.sim.worlds import walled

STOP, AHEAD, ASTERN = 38, 73, 3  # 0, 50 and -50 N, rudder amidships


@cache
def scenario(steps: int = 500) -> LoadedScenario:
    loaded = load("s3")
    task = loaded.scenario.task.model_copy(update={"max_steps": steps})
    return LoadedScenario(loaded.scenario.model_copy(update={"task": task}), loaded.base_dir, loaded.source)


def boats(count: int, *, steps: int = 500, wall: float = math.inf, **options: Any) -> DockingVectorEnv:
    return DockingVectorEnv(scenario(steps), count, worlds=[walled(wall)], **options)


def reset_at(env: DockingVectorEnv, *poses: tuple[float, float, float]) -> Any:
    return env.reset(seed=0, options={"poses": np.array([(x, y, math.radians(deg)) for x, y, deg in poses])})


AWAY = (10.0, -20.0, 0.0)


def test_same_step_is_declared() -> None:
    assert boats(2).metadata["autoreset_mode"] == AutoresetMode.SAME_STEP


def test_a_collision_ends_the_episode_of_one_boat_only() -> None:
    env = boats(3, wall=25.0)
    reset_at(env, AWAY, (24.99, 0, 0), AWAY)
    for _ in range(10):
        _, reward, terminated, truncated, info = env.step(np.full(3, AHEAD))
        if terminated.any():
            break
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert reward[1] == -30_000
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True, False]
    final = info["final_info"]
    assert final["outcome"][1] == "collision"
    assert final["collided_with"][1] == "wall"
    assert final["reward_terms"]["collision"][1] == -30_000
    assert final["pose"][1][0] > 25
    assert info["final_obs"][0] is None
    assert info["final_obs"][1] in env.single_observation_space


def test_the_row_after_an_end_is_the_first_of_the_next_episode() -> None:
    env = boats(2, steps=3)
    first, _ = env.reset(seed=0)
    for _ in range(3):
        observations, _, _, truncated, info = env.step(np.full(2, AHEAD))
    assert truncated.all()
    assert np.array_equal(observations, first)  # scenario 3 has one initial pose
    assert info["pose"] == pytest.approx(np.array([[23, -10, math.pi / 2]] * 2))
    assert info["outcome"].tolist() == ["", ""]
    assert all(not terms.any() for terms in info["reward_terms"].values())
    assert info["final_info"]["outcome"].tolist() == ["timeout", "timeout"]
    assert not np.array_equal(info["final_obs"][0], observations[0])
    assert not env.step(np.full(2, AHEAD))[3].any()


def test_steps_without_an_end_have_no_final_entries() -> None:
    env = boats(2)
    env.reset(seed=0)
    assert not {"final_obs", "final_info"} & set(env.step(np.full(2, STOP))[4])


def test_docking_on_the_last_step_is_not_a_timeout() -> None:
    env = boats(1, steps=2)
    reset_at(env, (18, 3, 150))
    assert env.step(np.array([STOP]))[1].tolist() == [30_000]
    env.simulator.eta[0] = 36, 0, math.pi
    _, reward, terminated, truncated, info = env.step(np.array([STOP]))
    assert (reward.tolist(), terminated.tolist(), truncated.tolist()) == ([30_000], [True], [False])
    assert info["final_info"]["outcome"][0] == "docked"
    assert info["final_info"]["phase"][0] == 1
    assert info["phase"].tolist() == [0]


def test_a_collision_on_the_last_step_is_not_a_timeout() -> None:
    env = boats(1, steps=1, wall=25.0)
    env.reset(seed=0)
    env.simulator.eta[0, 0] = 30
    _, _, terminated, truncated, info = env.step(np.array([STOP]))
    assert (terminated[0], truncated[0]) == (True, False)
    assert info["final_info"]["outcome"][0] == "collision"


def test_disabled_requires_a_reset_of_the_ended_rows() -> None:
    env = boats(2, wall=25.0, autoreset_mode=AutoresetMode.DISABLED)
    reset_at(env, AWAY, (24.999, 0, 0))
    ended = np.zeros(2, bool)
    while not ended.any():
        observations, _, terminated, truncated, info = env.step(np.full(2, AHEAD))
        ended = terminated | truncated
    assert info["outcome"].tolist() == ["", "collision"]
    with pytest.raises(ResetNeeded):
        env.step(np.full(2, AHEAD))
    after, _ = env.reset(options={"reset_mask": ended})
    assert np.array_equal(after[0], observations[0])
    assert not np.array_equal(after[1], observations[1])
    env.step(np.full(2, AHEAD))


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_equals_gymnasiums_synchronous_vector_of_single_boats(mode: AutoresetMode) -> None:
    """Step by step and key by key, over several episodes; all have the same initial pose."""
    ours, theirs = both(mode)
    rng = np.random.default_rng(5)
    assert_same(ours.reset(seed=1), theirs.reset(seed=1))
    ends = 0
    for _ in range(40):
        actions = rng.choice([AHEAD, AHEAD + 3, ASTERN - 3], 3)
        mine, peer = ours.step(actions), theirs.step(actions)
        ends += int((mine[2] | mine[3]).sum())
        assert_same(mine, peer)
    assert ends > 10


def both(mode: AutoresetMode) -> tuple[DockingVectorEnv, SyncVectorEnv]:
    """Return our vector of three boats, and Gymnasium's of three single environments."""
    worlds = [walled(23.3)]
    ours = DockingVectorEnv(scenario(7), 3, worlds=worlds, autoreset_mode=mode)
    singles = [lambda: DockingEnv(scenario(7), worlds=worlds)] * 3
    return ours, SyncVectorEnv(singles, autoreset_mode=mode)


def test_the_step_after_an_end_only_resets_the_boat() -> None:
    env = boats(2, wall=25.0, autoreset_mode="NextStep")
    reset_at(env, AWAY, (24.999, 0, 0))
    ended = np.zeros(2, bool)
    while not ended.any():
        _, _, terminated, truncated, info = env.step(np.full(2, AHEAD))
        ended = terminated | truncated
    assert info["outcome"].tolist() == ["", "collision"]
    before = env.simulator.eta.copy()
    _, reward, terminated, truncated, info = env.step(np.full(2, AHEAD))
    assert not (terminated | truncated).any()
    assert info["pose"][1] == pytest.approx([23, -10, math.pi / 2])  # the initial pose
    assert not np.array_equal(info["pose"][0], before[0])
    assert (reward[1], reward[0] < 0) == (0, True)
    assert info["outcome"].tolist() == ["", ""]
    assert env.simulator.steps.tolist()[1] == 0


def test_the_first_step_needs_a_reset_in_every_mode() -> None:
    for mode in AutoresetMode:
        with pytest.raises(ResetNeeded):
            boats(2, autoreset_mode=mode).step(np.full(2, AHEAD))


WRAPPERS: dict[str, Callable[[Any], Any]] = {
    "NormalizeObservation": vector.NormalizeObservation,
    "NormalizeReward": vector.NormalizeReward,
    "RecordEpisodeStatistics": vector.RecordEpisodeStatistics,
    "TransformReward": lambda env: vector.TransformReward(env, lambda reward: reward / 1000),
    "ClipReward": lambda env: vector.ClipReward(env, -10, 10),
    "RescaleObservation": lambda env: vector.RescaleObservation(env, 0, 1),
    "DictInfoToList": vector.DictInfoToList,
}

BOTH = [name for name in WRAPPERS if "Observation" not in name]  # the others refuse same-step autoreset


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        *((name, AutoresetMode.NEXT_STEP) for name in WRAPPERS),
        *((name, AutoresetMode.SAME_STEP) for name in BOTH),
    ],
)
def test_gymnasiums_vector_wrappers_give_the_same_as_over_its_own_vector(
    name: str, mode: AutoresetMode
) -> None:
    ours, theirs = (WRAPPERS[name](env) for env in both(mode))
    rng = np.random.default_rng(5)
    assert np.array_equal(ours.reset(seed=1)[0], theirs.reset(seed=1)[0])
    finished = 0
    for _ in range(25):
        actions = rng.choice([AHEAD, AHEAD + 3, ASTERN - 3], 3)
        mine, peer = ours.step(actions), theirs.step(actions)
        assert all(np.array_equal(a, b) for a, b in zip(mine[:4], peer[:4], strict=True))
        finished += int((mine[2] | mine[3]).sum())
        if name == "RecordEpisodeStatistics" and "episode" in peer[4]:
            for key in ("r", "l"):
                assert np.array_equal(mine[4]["episode"][key], peer[4]["episode"][key])
        if name == "DictInfoToList":
            assert [info["outcome"] for info in mine[4]] == [info["outcome"] for info in peer[4]]
    assert finished > 5


def assert_same(mine: Any, peer: Any) -> None:
    """Compare where Gymnasium's masks are true; the other values are undefined. Without masks, all rows."""
    for ours, theirs in zip(mine[:-1], peer[:-1], strict=True):
        assert np.array_equal(ours, theirs)
    assert_same_info(mine[-1], peer[-1])


def assert_same_info(mine: dict[str, Any], peer: dict[str, Any]) -> None:
    assert {key for key in mine if key[0] != "_"} == {key for key in peer if key[0] != "_"}
    for key in mine:
        if key[0] == "_":
            assert np.array_equal(mine[key], peer[key])
        elif isinstance(mine[key], dict):
            assert_same_info(mine[key], peer[key])
        else:
            for row in np.flatnonzero(peer.get(f"_{key}", np.ones(len(mine[key])))):
                assert np.array_equal(mine[key][row], peer[key][row]), key
