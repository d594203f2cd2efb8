"""Observations: the parts that a scenario lists, side by side."""

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
"""Boats in the view that the shapes are checked with; with one boat, (n, k) and (1, k) look the same."""


class ObservationEncoder:
    """Computes observations from views: the columns of all parts, in the scenario's order.

    Attributes:
        names: names of the k columns.
        space: Box of float32, (k,).

    Args:
        parts: the parts that the scenario lists.
        sectors: number of sectors of the range sensor.

    Raises:
        DockctlError: a part or one of its parameters is unknown, a parameter is missing, or a part returns
            columns of the wrong shape.
    """

    def __init__(self, parts: Sequence[ObservationPart], sectors: int) -> None:
        self._parts = [OBSERVATION_PARTS.get(given.part).bind(given.params) for given in parts]
        blank = _blank_view(sectors)
        columns = [_checked(given.part, part(blank)) for given, part in zip(parts, self._parts, strict=True)]
        self.names = tuple(name for column in columns for name in column.names)
        low, high = (np.concatenate(bounds) for bounds in zip(*map(_bounds, columns), strict=True))
        self.space = Box(low, high)

    def __call__(self, view: View) -> NDArray[np.float32]:
        """Return the observations (n, k) of n boats, clipped to the bounds."""
        values = np.hstack([part(view).values for part in self._parts]).astype(np.float32)
        return np.clip(values, self.space.low, self.space.high)


def _checked(part: str, columns: Columns) -> Columns:
    """Return the columns that a part returned for the blank view, after a check of their shapes."""
    right = (BLANK_BOATS, len(columns.names))
    if np.shape(columns.values) != right:
        raise DockctlError(
            f"observation part '{part}' returned values of shape {np.shape(columns.values)} for"
            f" {right[0]} boats, expected one row per boat and one column per name, {right}",
            code="plugin",
        )
    for bound in (columns.low, columns.high):
        if np.shape(bound) not in ((), right[1:]):
            raise DockctlError(
                f"observation part '{part}' returned a bound of shape {np.shape(bound)},"
                f" expected one number, or one per name, {right[1:]}",
                code="plugin",
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
