"""From a scenario to the observation and action spaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from dockctl.envs.observation import Columns, View
from dockctl.errors import DockctlError
from dockctl.plugins import OBSERVATION_PARTS
from dockctl.scenarios.schema import ObservationPart

BLANK_BOATS = 2
"""Boats on which the shapes are tried; with one alone, a row a boat and a single row look the same."""


class ObservationEncoder:
    """Turns views into observations, the parts side by side in the scenario's order.

    Args:
        parts: what the scenario lists.
        sectors: how many LiDAR sectors a view has.

    Raises:
        DockctlError: a part or one of its parameters is unknown, a parameter is missing, or a part gives
            columns of another shape than (n, k).
    """

    def __init__(self, parts: Sequence[ObservationPart], sectors: int) -> None:
        self._parts = [OBSERVATION_PARTS.get(given.part).bound(given.params) for given in parts]
        blank = _blank_view(sectors)
        columns = [_checked(given.part, part(blank)) for given, part in zip(parts, self._parts, strict=True)]
        self.names = tuple(name for column in columns for name in column.names)
        low, high = (np.concatenate(bounds) for bounds in zip(*map(_bounds, columns), strict=True))
        self.space = Box(low, high)

    def __call__(self, view: View) -> NDArray[np.float32]:
        """Return the observations (n, k) of n boats."""
        values = np.hstack([part(view).values for part in self._parts]).astype(np.float32)
        return np.clip(values, self.space.low, self.space.high)


def _checked(part: str, columns: Columns) -> Columns:
    """Return the columns that a part gave of the blank view if their shape is right."""
    right = (BLANK_BOATS, len(columns.names))
    if np.shape(columns.values) != right:
        raise DockctlError(
            f"observation part '{part}' gave values of shape {np.shape(columns.values)} for {right[0]} boats,"
            f" expected a row a boat and a column a name, {right}"
        )
    for bound in (columns.low, columns.high):
        if np.shape(bound) not in ((), right[1:]):
            raise DockctlError(
                f"observation part '{part}' gave a bound of shape {np.shape(bound)},"
                f" expected one number, or one a name, {right[1:]}"
            )
    return columns


def _bounds(columns: Columns) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    count = len(columns.names)
    low, high = (np.broadcast_to(bound, count).astype(np.float32) for bound in (columns.low, columns.high))
    return low, high


def _blank_view(sectors: int) -> View:
    n, zeros = BLANK_BOATS, np.zeros
    return View(
        phase=zeros(n, np.int64),
        distance_m=zeros(n),
        heading_error_rad=zeros(n),
        eta=zeros((n, 3)),
        goal=zeros((n, 3)),
        nu=zeros((n, 3)),
        command=zeros((n, 2)),
        command_limit=np.ones(2),
        sector_ranges_m=zeros((n, sectors)),
    )
