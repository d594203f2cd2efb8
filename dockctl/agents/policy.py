"""Policies: from a batch of observations to a batch of actions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Info = Mapping[str, Any]


class Policy(Protocol):
    """Chooses the actions of n boats; it may keep state from step to step."""

    def reset(self, rows: NDArray[np.int64], info: Info) -> None:
        """Forget the episodes of the boats `rows` (k,), which start new ones; `info` is that of the reset."""
        ...

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action for each boat.

        Args:
            observation: (n, observation_size).
            info: of the same step, with n rows under each key.
        """
        ...
