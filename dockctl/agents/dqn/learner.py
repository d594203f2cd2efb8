"""What a learner is: something that makes gradient steps and can be put down and taken up again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from numpy.typing import NDArray

from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.dqn.replay import Transitions


class UpdateMetrics(NamedTuple):
    """Loss, mean |TD error|, mean Q of the actions taken, and gradient norm before clipping."""

    loss: float
    td_error: float
    q_mean: float
    gradient_norm: float


class Learner(Protocol):
    """Trains the network `online` in place, which stays in main memory, where the policy reads it."""

    online: DuelingQNetwork
    updates: int

    def update(self, transitions: Transitions, learning_rate: float) -> UpdateMetrics:
        """One gradient step on a batch, and a copy to the target network when one is due."""
        ...

    def state(self) -> dict[str, NDArray[Any]]:
        """Target network and optimizer's moments, for a checkpoint (which holds the online network apart)."""
        ...

    def load(self, state: Mapping[str, NDArray[Any]], updates: int) -> None:
        """Take over what `state` returned after so many updates, once `online` has its parameters.

        Raises:
            KeyError, ValueError, RuntimeError: the state is of another network.
        """
        ...
