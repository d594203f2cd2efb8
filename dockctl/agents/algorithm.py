"""What the trainer needs of a learning algorithm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from dockctl.agents.policy import Policy
from dockctl.errors import DockctlError

if TYPE_CHECKING:
    import numpy as np
    import torch

Tensors = Mapping[str, NDArray[Any]]
Metrics = Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Step:
    """One step of n boats.

    Attributes:
        observation: (n, observation_size), before the step.
        action: (n,) indices of discrete actions, or (n, action_size).
        reward: (n,), unscaled.
        next_observation: (n, observation_size), after the step and before any reset.
        terminated, truncated: (n,), whether the episode ended, and how.
    """

    observation: NDArray[Any]
    action: NDArray[Any]
    reward: NDArray[Any]
    next_observation: NDArray[Any]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Algorithm(Protocol):
    """Learns a policy from the steps of n boats.

    The trainer calls `act`, then `learn` in another thread while the environment steps, then `store`.

    Attributes:
        policy: the greedy policy; it follows the learning.
        epsilon: probability of a random action at the latest `act`; None if exploration has no such number.
        updates: gradient steps so far.
    """

    @property
    def policy(self) -> Policy: ...
    @property
    def epsilon(self) -> float | None: ...
    @property
    def updates(self) -> int: ...

    def act(self, observation: NDArray[Any], env_steps: int) -> NDArray[Any]:
        """Return an exploring action for each boat.

        Args:
            observation: (n, observation_size).
            env_steps: environment steps so far, all boats together.
        """
        ...

    def store(self, step: Step) -> None:
        """Add a step of all boats to the replay memory."""
        ...

    def learn(self, env_steps: int) -> Iterator[Metrics]:
        """Make the gradient steps due after `env_steps`, and yield the metrics of each or of several.

        Metrics become columns of ``updates.csv``; one of them is ``loss``.
        """
        ...

    def policy_tensors(self) -> Tensors:
        """Return the parameters of the policy, from which its `AlgorithmSpec` rebuilds it."""
        ...

    def state(self) -> tuple[Tensors, dict[str, Any]]:
        """Return everything else that `restore` needs: tensors, and facts for JSON."""
        ...

    def restore(self, policy: Tensors, tensors: Tensors, facts: Mapping[str, Any]) -> None:
        """Continue from what `policy_tensors` and `state` returned.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: the state belongs to another network.
        """
        ...


def torch_device(name: str) -> torch.device:
    """Return the torch device `name`, for example ``cpu`` or ``cuda``.

    Raises:
        DockctlError: the device is not available.
    """
    import torch

    try:
        device = torch.device(name)
        torch.zeros(1, device=device).cpu()  # fails for `meta`, which has no data
    except (RuntimeError, AssertionError) as error:  # without CUDA support torch raises AssertionError
        reason = str(error).partition("\n")[0]
        raise DockctlError(f"device '{name}' cannot be used: {reason}", code="unavailable") from None
    return device
