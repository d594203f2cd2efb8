"""Contract tests of scenarios with their environments, and of policies."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from dockctl.agents.interface import Policy
from dockctl.envs.single import DockingEnv
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.scenarios.loader import dump
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import load_checked, with_few_layouts
from dockctl.sim.lidar.spinning import SpinningLidars
from dockctl.sim.world import NothingInRange, World, build_worlds, in_open_water
from dockctl.testing.contract import ContractError, Rule, contract_of

SECTORS = 8  # of `open_water`

Rows = dict[str, NDArray[Any]]


def check_scenario(source: str | Path, *, steps: int = 40) -> None:
    """Check that a scenario loads, survives a round trip through YAML, and gives a valid environment.

    The environment is deterministic under a seed; a boat does not depend on the number of boats; a single
    boat equals a row of the vector; observations are in their space; rewards are finite sums of their terms;
    returned arrays are not shared with the environment; a state restored in a new environment continues.
    Of generated layouts, only the first few are built.
    """
    loaded = load_checked(source)
    scenario = loaded.scenario
    require = contract_of(f"scenario '{scenario.name}'")
    again = scenario.model_validate(scenario.model_dump(mode="json"))
    require("consistent", again == scenario, "the dump differs")
    require("valid", "name:" in dump(scenario), "the scenario has no name")
    few = with_few_layouts(scenario)
    check_environment(few, build_worlds(few, loaded.base_dir), steps=steps)


def check_policy(policy: Policy, env: DockingVectorEnv, *, steps: int = 40) -> None:
    """Check a policy: valid actions, no state left after a reset, inputs unchanged, row by row.

    The first boat follows the policy; the others take random actions, so that their states differ.

    Args:
        policy: must work for any number of boats.
        env: several boats, same-step autoreset.
        steps: control steps of the check.
    """
    what, boats = f"policy {type(policy).__name__}", env.num_envs
    single = DockingVectorEnv(env.scenario, 1, worlds=env.worlds)

    def actions(env: DockingVectorEnv) -> list[NDArray[Any]]:
        observation, info = env.reset(seed=5)
        env.action_space.seed(0)
        policy.reset(np.arange(env.num_envs), info)
        chosen = []
        for step in range(steps):
            require = contract_of(f"{what}, step {step}")
            before = {key: value.copy() for key, value in _arrays((observation, info)).items()}
            try:
                action = np.asarray(policy.act(observation, info))
            except DockctlError as error:  # of a policy from `load_policy`, which checks its own actions
                raise ContractError(what, "valid", f"step {step}: {error}") from error
            for key, value in _arrays((observation, info)).items():
                require("pure", np.array_equal(before[key], value), f"act changes {key}")
            space = env.single_action_space
            require(
                "shape",
                action.shape == env.action_space.shape,
                f"actions of shape {action.shape}, expected {env.action_space.shape}",
            )
            typed = action.astype(space.dtype)
            require("valid", np.array_equal(typed, action) or typed.dtype.kind == "f", f"actions {action}")
            require("in_range", all(map(space.contains, typed)), f"actions {action} not in {space}")
            chosen.append(action.copy())
            made = np.concatenate([typed[:1], env.action_space.sample()[1:]])
            observation, _, terminated, truncated, info = env.step(made)
            done = terminated | truncated
            done[1:] |= step == steps // 2  # as if the others began other episodes
            if done.any():
                policy.reset(np.flatnonzero(done), info)
        return chosen

    first, again, alone = actions(env), actions(env), actions(single)
    for step in range(steps):
        require = contract_of(f"{what}, step {step}")
        require("deterministic", np.array_equal(first[step], again[step]), "state left after reset")
        require(
            "independent_rows",
            np.array_equal(first[step][:1], alone[step]),
            f"the action of a boat depends on the other {boats - 1} boats",
        )


def open_water() -> World:
    """Return a world without obstacles in which all ranges are 100 m."""
    return in_open_water(NothingInRange(SpinningLidars(sectors=SECTORS)))


def check_environment(scenario: Scenario, worlds: Sequence[World], steps: int) -> None:
    """Check the vector environment of a scenario, and compare the single environment with it."""
    what, boats, seed = f"scenario '{scenario.name}'", 3, 5

    def make(number: int) -> DockingVectorEnv:
        return DockingVectorEnv(
            scenario, number, worlds=worlds, exploring=True, autoreset_mode=AutoresetMode.DISABLED
        )

    env, same, fewer, single = (
        make(boats),
        make(boats),
        make(2),
        DockingEnv(scenario, worlds=worlds, exploring=True),
    )
    env.action_space.seed(0)
    first = env.reset(seed=seed)
    returned = [_arrays(first), _arrays(same.reset(seed=seed)), _arrays(fewer.reset(seed=seed))]
    alone = _arrays(single.reset(seed=seed))
    rule: Rule = "deterministic"
    for step in range(steps):
        many, equal, few = returned
        require = contract_of(f"{what}, step {step}")
        for key, value in many.items():
            require("finite", value.dtype == object or np.isfinite(value).all(), f"{key} is not finite")
            require(rule, np.array_equal(value, equal[key]), f"{key} differs in an equal environment")
            require(
                "independent_rows",
                np.array_equal(value[:2], few[key]),
                f"{key} depends on the number of boats",
            )
            require("consistent", np.array_equal(value[0], alone[key]), f"{key} of a single boat differs")
        require("in_range", many["observation"] in env.observation_space, "observation out of bounds")
        for value in equal.values():  # the caller may overwrite them
            if value.dtype != object:
                value[:] = 0
        if step == steps // 2:
            try:
                arrays, facts = env.state()
            except DockctlError as error:  # of a condition with an attribute that cannot be saved
                raise ContractError(what, "resumable", str(error)) from error
            same, rule = make(boats), "resumable"
            same.restore(arrays, json.loads(json.dumps(facts)))
        action = env.action_space.sample()
        results = [env.step(action), same.step(action), fewer.step(action[:2])]
        lone = single.step(action[0])
        terms = sum(results[0][4]["reward_terms"].values())
        require("consistent", np.allclose(results[0][1], terms), "the reward is not the sum of its terms")
        returned, alone = [_arrays(result) for result in results], _arrays(lone)
        if (results[0][2] | results[0][3]).any():
            returned = [_arrays(each.reset()) for each in (env, same, fewer)]
            alone = _arrays(single.reset())


def _arrays(result: tuple[Any, ...]) -> Rows:
    """Return everything that `reset` or `step` returned as arrays by name."""
    names = {2: ("observation",), 5: ("observation", "reward", "terminated", "truncated")}[len(result)]
    values = dict(zip(names, result, strict=False))
    for key, value in result[-1].items():
        values |= {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
    return {key: np.asarray(value) for key, value in values.items()}
