"""Experience replay with n-step returns, for a vector environment."""

from __future__ import annotations

from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Step, Tensors
from dockctl.dueling import Mirror

Array = TypeVar("Array")  # of numpy or torch


class Transitions(NamedTuple, Generic[Array]):
    """m n-step transitions, as arrays or as tensors.

    Attributes:
        observation, next_observation: (m, observation_size) float32; the value is bootstrapped from the next.
        action: (m,) index of the action taken in `observation`.
        reward: (m,) discounted sum of the k rewards between the two.
        discount: (m,) weight of the value of `next_observation`: gamma^k, or 0 where the episode terminated.
    """

    observation: Array
    action: Array
    reward: Array
    discount: Array
    next_observation: Array


Batch = Transitions[NDArray[Any]]


def mirror_every_second(batch: Batch, mirror: Mirror) -> None:
    """Replace every second transition by its mirror image, in place."""
    for observation in (batch.observation, batch.next_observation):
        observation[::2] = mirror.observations(observation[::2])
    batch.action[::2] = mirror.actions[batch.action[::2]]


class NStep:
    """Turns the steps of `boats` boats into n-step transitions.

    A transition is ready after n rewards, or when its episode ends: then it has fewer rewards, and is
    bootstrapped if the episode was truncated but not if it terminated.
    """

    def __init__(self, boats: int, n: int, gamma: float, observation_size: int) -> None:
        # Axis 0 is the age: row 0 holds the newest step of every boat, row n - 1 the oldest.
        self._observation = np.zeros((n, boats, observation_size), np.float32)
        self._action = np.zeros((n, boats), np.int64)
        self._reward = np.zeros((n, boats))
        self._waiting = np.zeros(boats, np.int64)
        self._age = np.arange(n)[:, None]
        self._gamma = gamma

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the steps that still need rewards."""
        return {
            "observation": self._observation,
            "action": self._action,
            "reward": self._reward,
            "waiting": self._waiting,
        }

    def load(self, state: Tensors, actions: int) -> None:
        """Continue with what `state` returned; there are `actions` actions.

        Raises:
            ValueError: the state has different shapes, or an action that does not exist.
        """
        _require_actions(state["action"], actions)
        for name, array in self.state().items():
            array[:] = state[name]

    def add(self, step: Step) -> Batch:
        """Add one step of all boats, and return the transitions that became ready, any number of them."""
        n, done = len(self._age), step.terminated | step.truncated
        newest = ((self._observation, step.observation), (self._action, step.action), (self._reward, 0.0))
        for buffer, values in newest:
            buffer[1:] = buffer[:-1]
            buffer[0] = values
        self._reward += self._gamma**self._age * step.reward
        self._waiting += 1
        ready = (self._age < self._waiting) & ((self._age == n - 1) | done)
        age, boat = np.nonzero(ready)
        self._waiting = np.where(done, 0, np.minimum(self._waiting, n - 1))
        return Transitions(
            observation=self._observation[age, boat],
            action=self._action[age, boat],
            reward=self._reward[age, boat].astype(np.float32),
            discount=(self._gamma ** (age + 1) * ~step.terminated[boat]).astype(np.float32),
            next_observation=step.next_observation[boat].astype(np.float32),
        )


class Replay:
    """The latest `capacity` transitions, sampled uniformly with replacement.

    A transition is one contiguous record, so that reading it needs one memory access.
    """

    def __init__(self, capacity: int, observation_size: int, rng: np.random.Generator) -> None:
        self._records = np.zeros(capacity, record(observation_size))
        self._added = 0
        self.rng = rng

    def __len__(self) -> int:
        return min(self._added, len(self._records))

    @staticmethod
    def bytes_needed(capacity: int, observation_size: int) -> int:
        """Return the size of a replay buffer of this capacity [bytes]."""
        return capacity * record(observation_size).itemsize

    def add(self, transitions: Batch) -> None:
        """Store a batch; when full, it overwrites the oldest transitions."""
        slots = (self._added + np.arange(len(transitions.action))) % len(self._records)
        for name, values in transitions._asdict().items():
            self._records[name][slots] = values
        self._added += len(slots)

    def sample(self, size: int) -> Batch:
        """Draw transitions uniformly, with replacement."""
        drawn = self._records.take(self.rng.integers(len(self), size=size))
        return Transitions(**{name: np.ascontiguousarray(drawn[name]) for name in drawn.dtype.names or ()})

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the records as bytes, (transitions, bytes), without a copy, and how many were ever added."""
        records = self._records[: len(self)].view(np.uint8).reshape(len(self), self._records.itemsize)
        return {"records": records, "added": np.array([self._added])}

    def load(self, state: Tensors, actions: int) -> None:
        """Continue with what `state` returned; there are `actions` actions.

        Raises:
            ValueError: the state holds more transitions than fit, has other shapes, or an action that does
                not exist.
        """
        records, added = state["records"], int(state["added"][0])
        shape = (min(added, len(self._records)), self._records.itemsize)
        if records.dtype != np.uint8 or records.shape != shape:
            raise ValueError(f"the replay buffer has type {records.dtype} and shape {records.shape}")
        transitions = records.view(self._records.dtype)[:, 0]
        _require_actions(transitions["action"], actions)
        self._records[: len(records)] = transitions
        self._added = added


def _require_actions(stored: NDArray[Any], actions: int) -> None:
    """Check that the compiled gradient, which does not check indices, can use these actions."""
    if stored.size and not 0 <= stored.min() <= stored.max() < actions:
        raise ValueError(f"an action is not one of {actions}")


def record(observation_size: int) -> np.dtype[np.void]:
    """Return the layout of one stored transition; its fields are those of `Transitions`."""
    row = (np.float32, (observation_size,))
    return np.dtype(
        [
            ("action", np.int64),
            ("reward", np.float32),
            ("discount", np.float32),
            ("observation", *row),
            ("next_observation", *row),
        ]
    )
