"""Dry run: a few steps through every registered part of a scenario, before anything is written."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import ArrayLike

from dockctl.agents.algorithms import AlgorithmSpec, Dqn, MemoryUse, algorithm_of, discrete_sizes
from dockctl.agents.interface import Algorithm, Hysteretic, Mirrorable, Spaces, Step, Tensors
from dockctl.dueling import Hysteresis, Mirror
from dockctl.envs.hysteresis import action_hysteresis
from dockctl.envs.mirror import mirror_images
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import PluginError
from dockctl.plugins import (
    ACTIONS,
    ALGORITHMS,
    CONDITIONS,
    OBSERVATION_PARTS,
    RANGE_SENSORS,
    REWARD_TERMS,
    Guard,
)
from dockctl.registry import PACKAGE_ORIGIN, Registry
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.extensions import ActionType, RangeSensorSpec
from dockctl.scenarios.layouts import layouts
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import TRAINING_CONDITIONS
from dockctl.sim.checks import located
from dockctl.sim.vessel import ReferenceVesselModel
from dockctl.sim.world import NothingInRange, in_open_water, scan_points, scan_sectors

BOATS, STEPS = 4, 3
DRAWS, PERIODS, SUBSTEPS = 64, 20, 1000
"""Number of episodes with conditions, their control periods, and the limit on their total substeps."""
WALL = np.array([[[10, -9, -1], [10, 9, -1], [10, 9, 6]], [[10, -9, -1], [10, 9, 6], [10, -9, 6]]], float)
"""What the range sensor sees."""
WALL.flags.writeable = False  # as in a `World`
ROUNDING = 1e-9
"""Relative excess of a command over its limit that comes from converting units."""


def dry_run(loaded: LoadedScenario) -> None:
    """Step a few boats in open water: starts, steps, each event, the end of an episode, a save and a restore.

    Range sensors from plugins are built and used, and so is any algorithm except ``dqn``. Built-in sensors,
    ``dqn`` and the compiled vessel are skipped: loading them takes longer than everything else here.

    Raises:
        InputError: the algorithm or the conditions do not match the scenario.
        PluginError: a plugin failed, or returned a value that is not finite.
        DockctlError: the state of a condition cannot be saved.
    """
    with np.errstate(all="ignore"):  # values that are not finite are errors, which name their origin
        _dry_run(loaded)


def _dry_run(loaded: LoadedScenario) -> None:
    with located(loaded):
        _step(loaded)
        _integrate(loaded)
    if loaded.scenario.training.conditions:
        with located(loaded, TRAINING_CONDITIONS):
            trained = replace(loaded, scenario=loaded.scenario.with_training_conditions())
            _step(trained)
            _integrate(trained)


def _environment(loaded: LoadedScenario, boats: int) -> DockingVectorEnv:
    """Return an environment at the starts of its first episodes."""
    scenario = loaded.scenario
    lidar = scenario.sensors.lidar
    with Guard(RANGE_SENSORS, lidar.kind):
        _require_hashable(lidar)
        is_own = RANGE_SENSORS.origin(lidar.kind) == PACKAGE_ORIGIN
        world = in_open_water(NothingInRange(lidar) if is_own else lidar.build(WALL))
    worlds = [world] * len(layouts(scenario.harbor, scenario.task.berths))
    env = DockingVectorEnv(loaded, boats, exploring=True, worlds=worlds)
    env.simulator.vessel = ReferenceVesselModel(scenario.vessel)
    env.action_space.seed(0)
    env.reset(seed=0)
    return env


def _step(loaded: LoadedScenario) -> None:
    scenario = loaded.scenario
    lidar, env = scenario.sensors.lidar, _environment(loaded, BOATS)
    _require_described(ACTIONS, scenario.actions)
    _require_within_limits(env)
    for condition in scenario.conditions.values():
        with Guard(CONDITIONS, condition.kind):
            _require_notes(condition.notes(scenario.vessel))
            side_force = condition.side_force_n(scenario.vessel)
            _require_finite(CONDITIONS, condition.kind, side_force, "side_force_n of ")
    for _ in range(STEPS):
        actions = env.action_space.sample()
        with Guard(ACTIONS, scenario.actions.kind):
            previous = env.simulator.command.copy()
            commands = scenario.actions.next_commands(np.asarray(actions), scenario.vessel, previous)
            _require_finite(ACTIONS, scenario.actions.kind, commands)
        observation, _, _, _, info = env.step(actions)
        _require_finite(RANGE_SENSORS, lidar.kind, env.simulator.sector_ranges_m)
        scan_points(env.worlds[0].lidar, lidar.kind, env.simulator.eta[0])
        scan_sectors(env.worlds[0].lidar, lidar, env.simulator.eta[0])
        with Guard(RANGE_SENSORS, lidar.kind):
            sizes = {"table_bytes": env.worlds[0].lidar.table_bytes, "shared_bytes": lidar.shared_bytes}
            for name, size in sizes.items():
                if np.asarray(size).dtype.kind not in "iuf" or not size >= 0:
                    raise ValueError(f"{name} is {size!r}, expected a number of bytes")
        for part, values in zip(env.observation_parts, observation.T, strict=True):
            _require_finite(OBSERVATION_PARTS, part, values)
        _require_finite_terms(info["reward_terms"])
        env.simulator.max_steps[:] = 1  # the next step ends all episodes
    env.restore(*env.state())
    status = env.simulator.step(np.zeros((BOATS, 2)))
    collided, intermediate, final = np.eye(3, BOATS, dtype=bool)
    _, by_term = env.reward(
        replace(status, collided=collided, reached_intermediate=intermediate, reached_final=final)
    )
    _require_finite_terms(by_term)
    if scenario.training.mirrored:
        mirror_images(scenario)
    if scenario.training.hysteresis is not None:
        action_hysteresis(scenario, scenario.training.hysteresis)
    spec, spaces = algorithm_of(scenario.training), Spaces.from_env(env)
    _require_described(ALGORITHMS, spec)
    with Guard(ALGORITHMS, spec.kind):
        _require_memory_uses(spec.memory(spaces, scenario.training))
    if type(spec) is Dqn:
        discrete_sizes(spaces)
    elif not spec.imports:  # a module named in a scenario is imported only for training
        _require_saved(loaded, spaces)
        with Guard(ALGORITHMS, spec.kind):
            _learn(build_algorithm(loaded, spaces, BOATS, "cpu"), env)


def _require_hashable(lidar: RangeSensorSpec) -> None:
    """Check that the sensors of a harbor can be found by their spec; a frozen model hashes its fields."""
    try:
        hash(lidar)
    except TypeError as error:
        raise TypeError(f"{error} in a key of the range sensor: use tuples for lists") from None


def _require_within_limits(env: DockingVectorEnv) -> None:
    """Check the commands of every discrete action, or else of random ones."""
    actions, vessel, space = env.scenario.actions, env.scenario.vessel, env.single_action_space
    with Guard(ACTIONS, actions.kind):
        given = env.action_space.sample()
        if isinstance(space, Discrete):
            given = space.start + np.arange(space.n)
        limit = env.simulator.vessel.command_limit
        commands = actions.next_commands(given, vessel, np.zeros((len(given), 2)))
        if (np.abs(commands) > limit * (1 + ROUNDING)).any():
            force, angle = np.abs(commands).max(axis=0)
            raise ValueError(
                f"commands of up to {force:g} N and {np.degrees(angle):g}°; the vessel has {limit[0]:g} N and"
                f" {np.degrees(limit[1]):g}°"
            )


def _require_described(registry: Registry[Any], part: ActionType | AlgorithmSpec) -> None:
    with Guard(registry, part.kind):
        if not isinstance(text := part.describe(), str):
            raise TypeError(f"describe returned {text!r}, expected text")


def _require_notes(notes: Any) -> None:
    for field, message in notes:
        if not isinstance(field, str) or not isinstance(message, str):
            raise TypeError(f"notes returned {notes!r}, expected a list of pairs of a field and a message")


def _require_memory_uses(uses: Any) -> None:
    for use in uses:
        if (
            not isinstance(use, MemoryUse)
            or np.asarray(use.size).dtype.kind not in "iuf"
            or not use.size >= 0
        ):
            raise TypeError(f"memory returned {uses!r}, expected a tuple of MemoryUse with a number of bytes")


def _require_saved(loaded: LoadedScenario, spaces: Spaces) -> None:
    """Check that policies for these spaces can be saved."""
    from dockctl.agents.checkpoint import CheckpointError, PolicyCard  # slow to import

    try:
        PolicyCard.for_spaces(spaces, scenario=loaded.scenario.name, seed=0)
    except CheckpointError as error:
        raise FieldError("actions", error.message, "mismatch") from None


def _learn(algorithm: Algorithm, env: DockingVectorEnv) -> None:
    """Take a few training steps, and one step with the greedy policy."""
    observation, info = env.reset(seed=0)
    algorithm.policy.reset(np.arange(BOATS), info)
    _ = algorithm.epsilon, algorithm.updates
    for step in range(STEPS):
        action = algorithm.act(observation, step * BOATS)
        for metrics in algorithm.learn(step * BOATS):
            _ = float(metrics["loss"])
            for value in metrics.values():
                math.isfinite(value)
        following, reward, terminated, truncated, info = env.step(action)
        algorithm.store(Step(observation, action, reward, following, terminated, truncated))
        observation = following
    env.step(algorithm.policy.act(observation, info))
    _require_numbers(algorithm.policy_tensors())
    tensors, facts = algorithm.state()
    _require_numbers(tensors)
    json.dumps(facts)


def _require_numbers(tensors: Tensors) -> None:
    for name, values in tensors.items():
        if np.asarray(values).dtype.kind not in "biuf":
            raise TypeError(f"the tensor '{name}' does not consist of numbers")


def _integrate(loaded: LoadedScenario) -> None:
    """Give many boats full thrust in their conditions: a current may exceed the vessel's own speed.

    Raises:
        IntegrationError: the integration diverged.
    """
    vessel = loaded.scenario.vessel
    if not loaded.scenario.conditions:  # the vessel's validator checked stability in calm water
        return
    simulator, rng = _environment(loaded, DRAWS).simulator, np.random.default_rng(0)
    for _ in range(min(PERIODS, max(1, SUBSTEPS // vessel.substeps))):
        simulator.step(rng.choice([-1, 1], (DRAWS, 2)) * simulator.vessel.command_limit)


def build_algorithm(loaded: LoadedScenario, spaces: Spaces, boats: int, device: str) -> Algorithm:
    """Build the learning algorithm of a scenario.

    Raises:
        InputError: it does not match the scenario.
        DockctlError: it failed, or the device or a library is not available.
    """
    training = loaded.scenario.training.model_copy(update={"boats": boats})
    spec = algorithm_of(training)
    with Guard(ALGORITHMS, spec.kind), located(loaded):
        try:
            algorithm = spec.build(spaces, training, device)
        except MemoryError as error:  # the replay buffer is allocated at its full capacity
            raise FieldError("training.replay_capacity", f"is too large: {error}", "unavailable") from None
        if training.mirrored:
            if not isinstance(algorithm, Mirrorable):
                message = f"the algorithm '{spec.kind}' cannot learn from mirror images"
                raise FieldError("training.mirrored", message, "mismatch")
            algorithm.learn_mirrored(Mirror(*mirror_images(loaded.scenario)))
        if training.hysteresis is not None:
            if not isinstance(algorithm, Hysteretic):
                message = f"the policy of the algorithm '{spec.kind}' cannot keep its actions"
                raise FieldError("training.hysteresis", message, "mismatch")
            margin = training.hysteresis * training.reward_scale
            algorithm.keep_actions(Hysteresis(*action_hysteresis(loaded.scenario, margin)))
    return algorithm


def _require_finite_terms(by_term: dict[str, Any]) -> None:
    for name, values in by_term.items():
        _require_finite(REWARD_TERMS, name, values)


def _require_finite(registry: Registry[Any], name: str, values: ArrayLike, what: str = "") -> None:
    if not np.isfinite(values).all():
        entry = registry.get(name)
        raise PluginError(f"{entry.origin}: {what}{registry.noun} '{name}' is not finite{entry.place}")
