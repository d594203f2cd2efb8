"""Hysteresis of a greedy policy: it keeps its last action until another one is better by a margin.

Where two action values are nearly equal, a greedy policy can alternate between ahead and astern forever.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dockctl.envs.observation import ObservationEncoder
from dockctl.geometry import Ints
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.schema import Scenario

FIELD = "training.hysteresis"


def action_hysteresis(
    scenario: Scenario, margin: float
) -> tuple[Ints, NDArray[np.float32], NDArray[np.float32]]:
    """Return how a policy recognizes its last action in an observation, and what to add to its value.

    Args:
        scenario: its actions are discrete and each is a command, and the observation has the part `command`.
        margin: in units of the action values.

    Returns:
        The columns of the last command (2,); the command of each action as observed (actions, 2); and the
        margin of each action (actions,), 0 without thrust, so that a boat at rest does not keep waiting.

    Raises:
        FieldError: the observation has no last command, or the actions are not commands.
    """
    encoder = ObservationEncoder(scenario.observation, scenario.sensors.lidar.sectors)
    columns = np.flatnonzero(np.array(encoder.parts) == "command")
    if not len(columns):
        raise FieldError(FIELD, "needs the last command: the part 'command' in the observation", "mismatch")
    commands = scenario.actions.command_table(scenario.vessel)
    if commands is None:
        message = (
            f"needs discrete actions that are commands, such as kind 'grid', not '{scenario.actions.kind}'"
        )
        raise FieldError(FIELD, message, "mismatch")
    observed = (commands / scenario.vessel.command_limit).astype(np.float32)
    return columns[:2], observed, np.where(commands[:, 0] == 0, 0, margin).astype(np.float32)
