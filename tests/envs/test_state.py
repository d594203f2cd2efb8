"""Saving and restoring the environment in the middle of episodes."""

from __future__ import annotations

import copy
import json
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save

import dockctl.envs  # noqa: F401 - registers the names
from dockctl.envs.state import BIT_GENERATORS, pack, unpack
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.geometry import Floats, Ints
from dockctl.plugins import CONDITIONS
from dockctl.scenarios.extensions import Condition, Disturbance, register
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.loader import load as load_scenario
from tests.envs.test_autoreset import assert_same
from tests.sim.worlds import walled

SHORT = ["task.max_steps=20", "training.exploring_starts.steps=12"]
CURRENT = "current: {speed_mps: [0.0, 0.1], direction_deg: [0, 360]}"


def boats(number: int = 3, *, conditions: str = CURRENT) -> DockingVectorEnv:
    return DockingVectorEnv(scenario_3(conditions), number, exploring=True, worlds=[walled(24.0)])


@cache
def scenario_3(conditions: str) -> LoadedScenario:
    return load_scenario("s3", overrides=[*SHORT, f"conditions={{{conditions}}}"])


def through_files(state: tuple[dict[str, Any], dict[str, Any]]) -> tuple[dict[str, Any], dict[str, Any]]:
    arrays, facts = state
    return load(save(arrays)), json.loads(json.dumps(facts))


def assert_continues(env: DockingVectorEnv, fresh: DockingVectorEnv, seed: int, steps: int) -> int:
    """Restore the state of `env` in `fresh`, compare both step by step, and return the number of ends."""
    before = env.state()
    observations, info = fresh.restore(*through_files(before))
    assert np.array_equal(observations, env._observe())
    assert np.array_equal(info["pose"], env.simulator.eta)
    rng, ends = np.random.default_rng(seed), 0
    for _ in range(steps):
        actions = rng.integers(0, 77, env.num_envs)
        one, other = env.step(actions), fresh.step(actions)
        assert_same(one, other)
        ends += int((one[2] | one[3]).sum())
    assert_same(env.reset(), fresh.reset())
    return ends


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), before=st.integers(0, 40), after=st.integers(0, 30))
def test_a_restored_environment_continues_bit_for_bit(seed: int, before: int, after: int) -> None:
    env, rng = boats(), np.random.default_rng(seed)
    env.reset(seed=seed)
    for _ in range(before):
        env.step(rng.integers(0, 77, 3))
    assert_continues(env, boats(), seed, after)


def test_restoring_covers_resets_and_starts_in_several_harbors() -> None:
    def env() -> DockingVectorEnv:
        source = load_scenario("marina", overrides=[*SHORT, f"conditions={{{CURRENT}}}"])
        worlds = [walled(100.0 + i) for i in range(20)]
        return DockingVectorEnv(source, 6, exploring=True, worlds=worlds)

    saved = env()
    saved.reset(seed=3)
    for _ in range(7):
        saved.step(np.full(6, 73))
    assert len(set(saved.simulator.harbor)) > 1
    assert assert_continues(saved, env(), 3, 60) > 10


def test_the_state_has_every_array_of_the_simulator() -> None:
    env = boats()
    env.reset(seed=0)
    arrays, _ = env.state()
    of_boats = {key for key, value in vars(env.simulator).items() if isinstance(value, np.ndarray)}
    assert of_boats == {key.removeprefix("simulator.") for key in arrays if key.count(".") == 1}


def test_saving_changes_nothing_and_is_not_changed() -> None:
    env, other = boats(), boats()
    env.reset(seed=0), other.reset(seed=0)
    arrays, facts = env.state()
    copies = {name: array.copy() for name, array in arrays.items()}
    text = json.dumps(facts)
    for _ in range(25):
        assert_same(env.step(np.full(3, 70)), other.step(np.full(3, 70)))
    assert all(np.array_equal(copies[name], array) for name, array in arrays.items())
    other.restore(arrays, facts)
    other.step(np.full(3, 70))
    assert all(np.array_equal(copies[name], array) for name, array in arrays.items())
    assert json.dumps(facts) == text


class Eddies(Disturbance):
    """A current from generators of its own, with a state of many types."""

    def __init__(self, spec: Condition, num_boats: int) -> None:
        self.spec = spec
        self.generators = {row: np.random.default_rng(row) for row in range(num_boats)}
        self.velocity = [np.zeros(2) for _ in range(num_boats)]
        self.drawn, self.pair, self.scale = 0, (1, np.float32(0.5)), np.array(0.05)

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        for row in rows.tolist():
            self.drawn += 1
            self.velocity[row] = self.scale * self.generators[row].normal(size=2) / (1 + self.drawn % 3)

    def water_velocity(self) -> Floats:
        return np.array(self.velocity) * self.pair[1]


class Opaque(Disturbance):
    """A condition whose state is in an object."""

    def __init__(self) -> None:
        self.values = iter([1.0])


class Explicit(Opaque):
    """The same, with methods that save it."""

    def __init__(self) -> None:
        super().__init__()
        self.resets = 0

    def reset(self, rows: Ints, rngs: Sequence[np.random.Generator]) -> None:
        self.resets += 1

    def state(self) -> dict[str, Any]:
        return {"resets": self.resets}


@pytest.fixture
def _conditions() -> None:
    @register(CONDITIONS, group="water")
    class EddiesSpec(Condition):
        kind: Literal["eddies"] = "eddies"

        def build(self, num_boats: int) -> Disturbance:
            return Eddies(self, num_boats)

    @register(CONDITIONS, group="air")
    class OpaqueSpec(Condition):
        kind: Literal["opaque"] = "opaque"
        explicit: bool = False

        def build(self, num_boats: int) -> Disturbance:
            return Explicit() if self.explicit else Opaque()


@pytest.mark.usefixtures("_conditions")
def test_a_condition_with_its_own_state_is_restored() -> None:
    def env() -> DockingVectorEnv:
        return boats(conditions="eddies: {}, current: {speed_mps: 0.1, direction_deg: 0}")

    saved, fresh = env(), env()
    saved.reset(seed=1)
    for _ in range(30):
        saved.step(np.full(3, 73))
    assert assert_continues(saved, fresh, 1, 60) > 5
    (mine, _), (theirs, _) = saved.simulator.disturbances, fresh.simulator.disturbances
    assert isinstance(mine, Eddies)
    assert isinstance(theirs, Eddies)
    assert (mine.drawn, mine.pair, type(theirs.pair[1])) == (theirs.drawn, theirs.pair, np.float32)


@pytest.mark.usefixtures("_conditions")
def test_a_state_that_cannot_be_saved_is_an_error_of_its_plugin() -> None:
    env = boats(conditions="opaque: {}")
    env.reset(seed=0)
    with pytest.raises(DockctlError) as caught:
        env.state()
    assert caught.value.code == "plugin"
    env = boats(conditions="opaque: {explicit: true}")
    env.reset(seed=0)
    assert_continues(env, boats(conditions="opaque: {explicit: true}"), 0, 5)


def test_states_of_other_environments_are_refused() -> None:
    env = boats()
    env.reset(seed=0)
    arrays, facts = env.state()
    plain = boats(conditions="")
    plain.reset(seed=0)
    for other, (given_arrays, given_facts) in (
        (boats(4), (arrays, facts)),
        (boats(), plain.state()),
        (boats(), ({}, facts)),
        (boats(), (arrays, {})),
        (boats(), (arrays, {**facts, "generators": {"generator": ["Hidden", {}]}})),
        (boats(), ({**arrays, "simulator.eta": arrays["simulator.eta"][:2]}, facts)),
        (boats(), ({**arrays, "simulator.harbor": arrays["simulator.harbor"] + 9}, facts)),
        (boats(), ({**arrays, "ended": np.array([False, True, False])}, facts)),
        (boats(), ({**arrays, "ended": np.zeros(3)}, facts)),
    ):
        other.reset(seed=5)
        before = json.dumps([other.state()[1], other.simulator.eta.tolist()])
        with pytest.raises(DockctlError) as caught:
            other.restore(given_arrays, given_facts)
        assert caught.value.code == "mismatch"
        assert json.dumps([other.state()[1], other.simulator.eta.tolist()]) == before


COPIES: dict[str, Callable[[Any], Any]] = {
    "copy": copy.deepcopy,
    "pickle": lambda env: pickle.loads(pickle.dumps(env)),
}


@pytest.mark.parametrize("how", COPIES)
def test_a_copy_continues_and_does_not_affect_the_original(how: str) -> None:
    env, twin = boats(), boats()
    for each in (env, twin):
        each.reset(seed=4)
        each.action_space.seed(4)
    for _ in range(9):
        env.step(env.action_space.sample()), twin.step(twin.action_space.sample())
    copied = COPIES[how](env)
    for _ in range(40):
        copied.step(copied.action_space.sample())
    copied.reset(seed=9)
    copied = COPIES[how](env)
    for _ in range(40):
        action = twin.action_space.sample()
        result = twin.step(action)
        for each in (env, copied):
            assert np.array_equal(each.action_space.sample(), action)
            assert_same(each.step(action), result)


@pytest.mark.parametrize("how", COPIES)
def test_a_copy_of_a_wrapped_single_environment_continues(how: str) -> None:
    env = gymnasium.make("dockctl/Docking-v0", scenario=scenario_3(CURRENT), worlds=[walled(24.0)])
    env.reset(seed=2)
    env.step(73)
    copied = COPIES[how](env)
    for _ in range(15):
        mine, theirs = env.step(70), copied.step(70)
        assert np.array_equal(mine[0], theirs[0])
        assert mine[1:4] == theirs[1:4]
    assert np.array_equal(env.reset()[0], copied.reset()[0])


@pytest.mark.parametrize("how", COPIES)
def test_copies_share_the_harbor(how: str) -> None:
    scenario = load_scenario("s3", overrides=["sensors={lidar: {kind: planar, rays: 36}}"])
    env = DockingVectorEnv(scenario, 2)
    env.reset(seed=0)
    copied = COPIES[how](env)
    assert copied.worlds[0] is env.worlds[0] is copied.simulator.worlds[0]
    assert_same(env.step(np.full(2, 73)), copied.step(np.full(2, 73)))


@pytest.mark.slow
@pytest.mark.thorough
def test_another_process_continues_from_a_pickle(tmp_path: Path) -> None:
    env = DockingVectorEnv(
        load_scenario("s3", overrides=["sensors={lidar: {kind: planar, rays: 36}}"]), 2, exploring=True
    )
    env.reset(seed=0)
    (tmp_path / "env.pickle").write_bytes(pickle.dumps(env))
    code = (
        "import pickle, sys, numpy as np; env = pickle.load(open(sys.argv[1], 'rb'));"
        "print(*(env.step(np.full(2, 3 * i))[0].tobytes().hex() for i in range(20)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "env.pickle")], capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [env.step(np.full(2, 3 * i))[0].tobytes().hex() for i in range(20)]


@pytest.mark.parametrize("kind", BIT_GENERATORS)
def test_every_generator_continues(kind: str) -> None:
    generator = np.random.Generator(BIT_GENERATORS[kind](5))
    generator.normal(size=3)
    arrays: dict[str, Any] = {}
    facts = pack(generator, "rng", arrays)
    restored = unpack(json.loads(json.dumps(facts)), arrays)
    assert np.array_equal(restored.normal(size=9), generator.normal(size=9))
    assert np.array_equal(
        restored.integers(9, size=9, dtype=np.int8), generator.integers(9, size=9, dtype=np.int8)
    )


def test_keys_that_look_alike_stay_apart() -> None:
    value = {"a": {"b": np.ones(1), 1: np.ones(2)}, "a.b": np.ones(3), "a.1": np.ones(4)}
    arrays: dict[str, Any] = {}
    facts = json.loads(json.dumps(pack(value, "x", arrays)))
    result = unpack(facts, arrays)
    assert (len(result["a"]["b"]), len(result["a"][1])) == (1, 2)
    assert (len(result["a.b"]), len(result["a.1"])) == (3, 4)


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array(["a"]), np.array([None]), 1j])
def test_values_that_json_and_arrays_cannot_hold_are_refused(value: Any) -> None:
    with pytest.raises(TypeError):
        pack([value], "x", {})
