"""The mirror image of observations and actions: port and starboard are swapped.

The vessel is symmetric, so the mirror image of a transition is a transition in the mirrored harbor. Images
are found by trial: each column of the mirrored observation must equal a column of the observation, or its
negative.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from dockctl.envs.observation import ObservationEncoder, View
from dockctl.geometry import Bools, Floats, Ints
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.schema import Scenario
from dockctl.sim.goal import measure

TRIALS, SAME = 32, 1e-5
FIELD = "training.mirrored"


def mirror_images(scenario: Scenario) -> tuple[Ints, NDArray[np.float32], Ints]:
    """Return how the mirror images of a scenario's observations and actions are computed.

    Returns:
        Columns and signs (observation_size,), by which the images of observations (n, observation_size) are
        ``observation[:, columns] * signs``; and the index of the image of each action (actions,).

    Raises:
        FieldError: the range sensor, a part of the observation or the actions have no mirror image.
    """
    if not scenario.sensors.lidar.is_symmetric:
        raise FieldError(FIELD, "the range sensor is not the same to port and to starboard", "mismatch")
    encoder = ObservationEncoder(scenario.observation, scenario.sensors.lidar.sectors)
    view = _random_view(scenario, encoder.past_steps, np.random.default_rng(0))
    # Not clipped: values at their bounds would be equal without being images of each other.
    given, mirrored = (
        np.hstack([np.divide(columns.values, columns.scale) for columns in encoder.columns(each)])
        for each in (view, view.mirrored())
    )
    columns, signs = _match(given, mirrored, encoder.parts)
    return columns, signs, _mirrored_actions(scenario)


def _match(given: Floats, mirrored: Floats, parts: tuple[str, ...]) -> tuple[Ints, NDArray[np.float32]]:
    """Return the column and the sign that give each mirrored column."""
    columns, signs = np.arange(len(parts)), np.ones(len(parts), np.float32)
    for i, part in enumerate(parts):
        for sign in (1, -1):
            same: Bools = np.all(np.abs(sign * given - mirrored[:, [i]]) < SAME, axis=0)
            if same.any():
                columns[i], signs[i] = i if same[i] else same.argmax(), sign
                break
        else:
            message = f"the observation part '{part}' has no mirror image with port and starboard exchanged"
            raise FieldError(FIELD, message, "mismatch")
    return columns, signs


def _mirrored_actions(scenario: Scenario) -> Ints:
    """Return the action (actions,) that gives the mirrored command, for any last command."""
    space = scenario.actions.space(scenario.vessel)
    if not isinstance(space, Discrete):
        raise FieldError(FIELD, f"needs discrete actions, not {space}", "mismatch")
    actions = np.arange(space.n)
    previous = scenario.vessel.command_limit * np.array([[0, 0], [0.5, 0.3], [-0.2, -0.4]])

    def commands(side: Floats) -> list[tuple[float, ...]]:
        each = [
            scenario.actions.next_commands(actions, scenario.vessel, np.tile(last * side, (len(actions), 1)))
            for last in previous
        ]
        return [_key(row) for row in np.hstack([command * side for command in each])]

    images = {command: action for action, command in enumerate(commands(np.array([1, -1])))}
    given = commands(np.array([1, 1]))
    if missing := [action for action, command in enumerate(given) if command not in images]:
        message = f"action {missing[0]} has no mirror image with the rudder to the other side"
        raise FieldError(FIELD, message, "mismatch")
    return np.array([images[command] for command in given])


def _key(commands: Floats) -> tuple[float, ...]:
    return tuple((np.round(commands, 9) + 0.0).tolist())  # not minus zero


def _random_view(scenario: Scenario, past_steps: int, rng: np.random.Generator) -> View:
    """Return a view within the bounds of the parts, with all values different."""
    goal = rng.uniform([-5, -5, -3], [5, 5, 3], (TRIALS, 3))
    eta = goal + rng.uniform([-5, -5, -1], [5, 5, 1], (TRIALS, 3))
    distance, heading_error = measure(eta, goal)
    limit = scenario.vessel.command_limit
    view = View(
        phase=rng.integers(2, size=TRIALS),
        distance_m=distance,
        heading_error_rad=heading_error,
        eta=eta,
        goal=goal,
        nu=rng.uniform([-0.4, -0.1, -0.04], [0.4, 0.1, 0.04], (TRIALS, 3)),
        command=limit * rng.uniform(-1, 1, (TRIALS, 2)),
        command_limit=limit,
        sector_ranges_m=rng.uniform(0, 10, (TRIALS, scenario.sensors.lidar.sectors)),
        apparent_wind=rng.uniform(-5, 5, (TRIALS, 2)),
        through_water=rng.uniform([-0.4, -0.1], [0.4, 0.1], (TRIALS, 2)),
    )
    return replace(view, past=tuple(_random_view(scenario, 0, rng) for _ in range(past_steps)))
