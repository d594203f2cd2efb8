"""The registered environments under the checkers of Gymnasium and Stable-Baselines3; warnings are errors."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import dockctl.envs  # noqa: F401 - registers the names
from dockctl.envs.single import DockingEnv
from dockctl.envs.vector import DockingVectorEnv

IDS = {"dockctl/S1-v0": 15, "dockctl/S2-v0": 15, "dockctl/S3-v0": 16}


@pytest.fixture(autouse=True)
def _warnings_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_gymnasium_checker(name: str) -> None:
    env = gymnasium.make(f"dockctl.envs:{name}")
    check_env(env.unwrapped)
    assert env.observation_space.shape == (IDS[name],)
    assert env.action_space == gymnasium.spaces.Discrete(77)


def test_stable_baselines_checker() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make("dockctl/S3-v0").unwrapped)


def test_any_scenario_by_name_and_by_path(tmp_path: Path) -> None:
    assert isinstance(gymnasium.make("dockctl/Docking-v0", scenario="s2").unwrapped, DockingEnv)
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: s1\nname: mine\ntask: {max_steps: 2}\n")
    env = gymnasium.make("dockctl/Docking-v0", scenario=str(mine))
    env.reset(seed=0)
    assert not env.step(38)[3]
    assert env.step(38)[3]


def test_the_native_vector_environment() -> None:
    env = gymnasium.make_vec(
        "dockctl/S3-v0", num_envs=3, vectorization_mode="vector_entry_point", exploring=True
    )
    assert isinstance(env, DockingVectorEnv)
    observations, _ = env.reset(seed=0)
    assert observations in env.observation_space
    assert env.step(env.action_space.sample())[1].shape == (3,)
    default = gymnasium.make_vec("dockctl/Docking-v0", num_envs=2, scenario="s1")
    assert isinstance(default, DockingVectorEnv)


def test_the_single_environment_is_row_0_of_the_vector() -> None:
    single, batch = gymnasium.make("dockctl/S3-v0"), gymnasium.make_vec("dockctl/S3-v0", num_envs=1)
    one, info = single.reset(seed=4)
    many, infos = batch.reset(seed=4)
    assert np.array_equal(one, many[0])
    for action in (73, 75, 0, 38):
        one, reward, *_, info = single.step(action)
        many, rewards, *_, infos = batch.step(np.array([action]))
        assert np.array_equal(one, many[0])
        assert reward == rewards[0]
        assert np.array_equal(info["pose"], infos["pose"][0])
        assert info["reward_terms"] == {name: value[0] for name, value in infos["reward_terms"].items()}


def test_rgb_array_rendering() -> None:
    env = gymnasium.make("dockctl/S3-v0", render_mode="rgb_array")
    env.reset(seed=0)
    env.step(73)
    frame = env.render()
    assert frame.dtype == np.uint8
    assert frame.ndim == 3
    assert frame.shape[2] == 3
    assert len(np.unique(frame.reshape(-1, 3), axis=0)) > 5
    check_env(env.unwrapped)


def test_registration_does_not_import_the_simulator() -> None:
    code = (
        "import sys, gymnasium, dockctl.envs; gymnasium.spec('dockctl/S3-v0');"
        "print(sorted({'numba', 'trimesh', 'fcl', 'torch'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
