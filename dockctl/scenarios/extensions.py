"""Base classes of the sections that are selected by `kind`: actions, range sensors, conditions.

To add one, write a subclass of one of these in a module of your own, name it in ``kind``, declare its keys as
fields, and register it with `dockctl.scenarios.kinds.register`. A section is validated before anything runs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from dockctl.scenarios.base import Count, Positive
from dockctl.scenarios.kinds import Kind
from dockctl.scenarios.vessel import Vessel

if TYPE_CHECKING:
    import gymnasium

Floats = NDArray[np.float64]


class ActionType(Kind, ABC):
    """What a policy's actions are, and the commands that they stand for; registered in `ACTIONS`."""

    @property
    @abstractmethod
    def description(self) -> str:
        """The actions in one line, for model cards."""

    @abstractmethod
    def space(self, vessel: Vessel) -> gymnasium.Space[Any]:
        """Return the action space of one boat."""

    @abstractmethod
    def commands(self, actions: NDArray[Any], vessel: Vessel) -> Floats:
        """Return propeller force [N] and rudder angle [rad], (n, 2), of n actions of the space."""

    def require_within_limits(self, vessel: Vessel) -> None:
        """Check that no command exceeds the limits of the vessel.

        Raises:
            ValueError: one does; the message begins with the path of the field, ``actions.key``.
        """
        return


class RangeSensor(Protocol):
    """A range sensor in one harbor. Poses are x, y [m] and heading [rad] in the world frame."""

    @property
    def table_bytes(self) -> int:
        """Memory that the sensor takes once it is in use [bytes], for the estimate before a training."""
        ...

    def sector_ranges(self, eta: Floats) -> Floats:
        """Return the nearest return of each sector (n, sectors) [m] from the poses (n, 3).

        It is the horizontal distance from the body's origin, and `range_m` where nothing returns; sectors
        are numbered as in `dockctl.geometry.sector_index`. Row i depends on pose i alone.
        """
        ...

    def points(self, pose: Floats) -> Floats:
        """Return all returns (k, 3) [m] in the body frame from one pose (3,), for drawings."""
        ...


class RangeSensorSpec(Kind, ABC):
    """A range sensor on the boat, as data; registered in `RANGE_SENSORS`.

    Equal specs must have equal hashes, so use tuples for lists: the sensor is built once for each harbor.
    """

    range_m: Positive = 100.0
    sectors: Count = Field(default=8, le=1024)

    @abstractmethod
    def build(self, triangles: Floats) -> RangeSensor:
        """Return the sensor in a harbor with this surface (m, 3, 3) [m], in the world frame."""
