"""Interfaces of policies and learning algorithms, and the data that they receive.

Environments are Gymnasium vector environments with same-step autoreset: when an episode ends, `step` returns
the first observation and info of the next one. Those of the step itself are in ``info["final_obs"]`` and
``info["final_info"]``; `final_observation` and `final_info` restore them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dockctl.dueling import Hysteresis, Mirror

if TYPE_CHECKING:
    from gymnasium.spaces import Space
    from gymnasium.vector import VectorEnv

Info = Mapping[str, Any]
Tensors = Mapping[str, NDArray[Any]]
Metrics = Mapping[str, float]


class Spaces(NamedTuple):
    """Observation and action space of one boat."""

    observation: Space[Any]
    action: Space[Any]

    @classmethod
    def from_env(cls, env: VectorEnv[Any, Any, Any]) -> Self:
        return cls(env.single_observation_space, env.single_action_space)


class Policy(Protocol):
    """Chooses the actions of n boats; may be stateful. A subclass without state needs no `reset`."""

    def reset(self, rows: NDArray[np.int64], info: Info) -> None:
        """Reset the state of the boats `rows` (k,), which start new episodes; `info` is from the reset."""
        return

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action for each boat.

        Args:
            observation: (n, observation_size).
            info: of the same step, with n rows under each key.
        """
        ...


@runtime_checkable
class QPolicy(Protocol):
    """A policy that chooses among discrete actions by their values."""

    def q_values(self, observation: NDArray[Any]) -> NDArray[np.float32]:
        """Return the values (n, actions) of the actions for observations (n, observation_size)."""
        ...


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

    The trainer calls `act`, then `learn`, whose iterator it consumes in another thread while the environment
    steps, then `store`. Only an `Overlapping` algorithm may act before the iterator is exhausted.

    Attributes:
        policy: the greedy policy learned so far.
        epsilon: probability of a random action in the latest `act`; None if exploration has no such number.
        updates: gradient steps so far.
    """

    @property
    def policy(self) -> Policy: ...
    @property
    def epsilon(self) -> float | None: ...
    @property
    def updates(self) -> int: ...

    def act(self, observation: NDArray[Any], env_steps: int) -> NDArray[Any]:
        """Return an exploratory action for each boat.

        Args:
            observation: (n, observation_size).
            env_steps: environment steps so far, summed over all boats.
        """
        ...

    def store(self, step: Step) -> None:
        """Add a step of all boats to the replay buffer."""
        ...

    def learn(self, env_steps: int) -> Iterator[Metrics]:
        """Take the gradient steps due after `env_steps`, and yield the metrics of each.

        Metrics become columns of ``updates.csv``; one of them is ``loss``.
        """
        ...

    def policy_tensors(self) -> Tensors:
        """Return the parameters of the policy, from which its `AlgorithmSpec` rebuilds it."""
        ...

    def state(self) -> tuple[Tensors, dict[str, Any]]:
        """Return everything else that `restore` needs: tensors, and facts for JSON.

        Tensors named ``unfinished.<name>`` belong to the episodes that have not ended. They are left out if
        the environment cannot be saved and starts new episodes. Of large tensors, a save writes the blocks of
        rows that have changed.
        """
        ...

    def restore(self, policy: Tensors, tensors: Tensors, facts: Mapping[str, Any]) -> None:
        """Continue from what `policy_tensors` and `state` returned, exactly as without the interruption.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: the state belongs to a different network.
        """
        ...


@runtime_checkable
class Overlapping(Protocol):
    """An algorithm that can act and store the next step while an iterator of `learn` is still consumed.

    If `acts_while_learning` is true, all iterators of `learn` but the last are exhausted at each call to
    `act`, whose result must not depend on the last one. While a policy is evaluated, `learn` is called for
    later steps as well, and then again for steps for which it has been called; it must not repeat updates,
    or change what `policy` and `policy_tensors` returned.
    """

    @property
    def acts_while_learning(self) -> bool: ...


@runtime_checkable
class Dueling(Protocol):
    """An algorithm whose network has an advantage stream."""

    def advantages(self, observation: NDArray[Any]) -> NDArray[Any]:
        """Return the output of the stream, (n, actions), for observations (n, observation_size)."""
        ...


@runtime_checkable
class FineTunable(Protocol):
    """An algorithm that can start from a trained policy."""

    def start_from(self, policy: Tensors, inputs: NDArray[np.int64]) -> None:
        """Start from the parameters of a policy, before the first step.

        Args:
            policy: what `policy_tensors` returned.
            inputs: (observation_size,) index of each column in the policy's observation; -1 for a new
                column, which must not change the actions.
        """
        ...


@runtime_checkable
class Mirrorable(Protocol):
    """An algorithm that can also learn from the mirror images of its transitions."""

    def learn_mirrored(self, mirror: Mirror) -> None:
        """From now on, also learn from mirror images."""
        ...


@runtime_checkable
class Hysteretic(Protocol):
    """An algorithm whose policy can keep its last action."""

    def keep_actions(self, hysteresis: Hysteresis) -> None:
        """From now on, the policy keeps its last action until another one is better by a margin."""
        ...


@runtime_checkable
class Recoverable(Protocol):
    """An algorithm that can try again from a saved state."""

    def recover(self, attempt: int) -> None:
        """Continue from the restored state: new episodes, other random numbers, slower learning.

        Args:
            attempt: number of rollbacks of the training run, from 1.
        """
        ...


@runtime_checkable
class Resumable(Protocol):
    """A vector environment whose episodes can be saved and continued."""

    def state(self) -> tuple[Tensors, dict[str, Any]]:
        """Return the state of every boat and of all generators: arrays, and facts for JSON.

        Raises:
            DockctlError: a part of it cannot be saved.
        """
        ...

    def restore(self, arrays: Tensors, facts: dict[str, Any]) -> tuple[NDArray[Any], Info]:
        """Continue from what `state` returned; return the observations (n, k) and info of that moment.

        Raises:
            DockctlError: it is the state of a different environment.
        """
        ...


def final_observation(observation: NDArray[Any], info: Info, done: NDArray[np.bool_]) -> NDArray[Any]:
    """Return the observations after the step and before any reset, (n, observation_size).

    If the environment does not provide them, they are the first observations of the next episodes.
    """
    if not done.any() or "final_obs" not in info:
        return observation
    final = observation.copy()
    final[done] = np.stack(list(info["final_obs"][done]))
    return final


def final_info(info: Info, done: NDArray[np.bool_]) -> Info:
    """Return the info after the step and before any reset."""
    return _overlay(info, info.get("final_info", {}), done) if done.any() else info


def _overlay(info: Info, final: Info, done: NDArray[np.bool_]) -> dict[str, Any]:
    overlaid: dict[str, Any] = {}
    for key, last in final.items():
        if isinstance(last, Mapping):
            overlaid[key] = _overlay(info.get(key, {}), last, done)
        else:
            rows = np.broadcast_to(done.reshape(-1, *[1] * (np.ndim(last) - 1)), np.shape(last))
            overlaid[key] = np.where(rows, last, info.get(key, last))
    return overlaid
