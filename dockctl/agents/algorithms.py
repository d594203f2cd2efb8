"""Learning algorithms that ``training.algorithm`` selects by `kind`.

    training:
      algorithm: {kind: sb3, model: SAC}

Importing this module does not import torch; building an algorithm does.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from dockctl.compute import limit_blas_threads
from dockctl.dueling import network_size, shapes, split
from dockctl.errors import DockctlError
from dockctl.plugins import ALGORITHMS
from dockctl.scenarios.base import FieldError, NonNegative
from dockctl.scenarios.extensions import Kind, register
from dockctl.trust import file_digest, remember, text_digest

if TYPE_CHECKING:
    from dockctl.agents.interface import Algorithm, Policy, Spaces, Tensors
    from dockctl.scenarios.schema import Scenario
    from dockctl.scenarios.training import Training


COPIES_IN_SAVING = 3
"""Copies of a checkpoint's tensors while it is written: arrays, serialized, and the content of the file."""


class MemoryUse(NamedTuple):
    """One use of memory: its name, size [bytes], and the field of the scenario that decides it."""

    name: str
    size: int
    field: str


class AlgorithmSpec(Kind):
    """Configuration of a learning algorithm. A subclass adds its keys as fields."""

    @property
    def imports(self) -> tuple[str, ...]:
        """Modules that a value of this section names, whose code runs when the algorithm is built."""
        return ()

    def describe(self) -> str:
        """Return a short description for model cards; by default the kind."""
        return self.kind

    def memory(self, spaces: Spaces, training: Training) -> tuple[MemoryUse, ...]:
        """Estimate what `build` and the training run allocate; negligible by default.

        Args:
            spaces: of one boat.
            training: the hyperparameters that all algorithms share.
        """
        return ()

    @abstractmethod
    def build(self, spaces: Spaces, training: Training, device: str) -> Algorithm:
        """Return the algorithm for ``training.boats`` boats.

        Args:
            spaces: of one boat.
            training: the hyperparameters that all algorithms share.
            device: torch device of the networks.

        Raises:
            FieldError: the algorithm does not support these spaces, or a key is invalid; the field begins
                with ``training.algorithm`` or ``actions``.
            DockctlError: the device or a library is not available.
        """

    @abstractmethod
    def load_policy(self, tensors: Tensors, spaces: Spaces, hidden_sizes: tuple[int, ...]) -> Policy:
        """Rebuild the greedy policy from what `Algorithm.policy_tensors` returned.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: the tensors belong to a different network.
            DockctlError: a library is missing.
        """


def algorithm_of(training: Training) -> AlgorithmSpec:
    """Return ``training.algorithm``; the type is checked here because `scenarios` cannot import it."""
    spec = training.algorithm
    assert isinstance(spec, AlgorithmSpec)
    return spec


def remember_code(scenario: Scenario) -> None:
    """Trust the local code of a user's own scenario: its runs need no ``--trust`` on this machine."""
    spec = algorithm_of(scenario.training)
    remember([*map(file_digest, map(Path, scenario.plugins)), *map(text_digest, spec.imports)])


@register(ALGORITHMS, source="sections 3.2.4-3.2.6")
class Dqn(AlgorithmSpec):
    """Dueling double DQN with n-step returns; its hyperparameters are the keys of ``training``."""

    kind: Literal["dqn"] = "dqn"

    def describe(self) -> str:
        return "dueling"

    def memory(self, spaces: Spaces, training: Training) -> tuple[MemoryUse, ...]:
        return _replay_and_networks(spaces, training)

    def build(self, spaces: Spaces, training: Training, device: str) -> Algorithm:
        from dockctl.agents.dqn.algorithm import DQN
        from dockctl.agents.tensors import torch_device

        size, actions = discrete_sizes(spaces)
        return DQN(size, actions, training, torch_device(device))

    def load_policy(self, tensors: Tensors, spaces: Spaces, hidden_sizes: tuple[int, ...]) -> Policy:
        from dockctl.agents.dqn.policy import GreedyPolicy

        if not hidden_sizes:
            raise ValueError("hidden_sizes is empty")
        expected = shapes(*discrete_sizes(spaces), hidden_sizes)
        for network in split(tensors)[0]:
            if (given := {name: array.shape for name, array in network.items()}) != expected:
                raise ValueError(f"weights of shapes {given}, expected {expected}")
        limit_blas_threads()
        return GreedyPolicy(tensors)


def _replay_and_networks(spaces: Spaces, training: Training) -> tuple[MemoryUse, ...]:
    """Estimate the memory of a replay buffer and of dueling networks."""
    from gymnasium.spaces import flatdim

    from dockctl.agents.dqn.replay import Replay

    size, actions = flatdim(spaces.observation), flatdim(spaces.action)
    parameters, outputs = network_size(size, actions, training.hidden_sizes)
    replay = Replay.bytes_needed(min(training.replay_capacity, training.total_steps), size)
    # Online and target network, gradient, two moments, and optimizer temporaries; four of them are saved.
    networks = 4 * (6 + 4 * COPIES_IN_SAVING) * parameters
    # Outputs of both networks for both observations, their gradients, and temporaries.
    batches = 4 * 6 * training.batch_size * (outputs + size)
    return (
        MemoryUse("replay", replay, "training.replay_capacity"),
        MemoryUse("copy of the replay when resuming", replay, "training.replay_capacity"),
        MemoryUse("networks", networks, "training.hidden_sizes"),
        MemoryUse("batches", batches, "training.batch_size"),
    )


def discrete_sizes(spaces: Spaces) -> tuple[int, int]:
    """Return the length of an observation and the number of actions.

    Raises:
        FieldError: the observation is not a vector, or the actions are not discrete from 0.
    """
    from gymnasium.spaces import Box, Discrete

    observation, action = spaces
    if not isinstance(observation, Box) or len(observation.shape) != 1:
        message = f"dqn needs vector observations, not {observation}"
        raise FieldError("training.algorithm", message, "mismatch")
    if not isinstance(action, Discrete) or action.start != 0:
        message = (
            f"dqn needs discrete actions from 0, not {action}: use 'actions: {{kind: grid}}', or an algorithm"
            " for continuous actions, such as 'algorithm: {kind: sb3, model: SAC}'"
        )
        raise FieldError("actions", message, "mismatch")
    return observation.shape[0], int(action.n)


@register(ALGORITHMS, source="https://stable-baselines3.readthedocs.io")
class StableBaselines3(AlgorithmSpec):
    """An off-policy algorithm from Stable-Baselines3, in that library's implementation.

    The keys of ``training`` set what both libraries have: seed, learning rate, replay, batch, discount,
    n-step, warm-up, steps per update, epsilon, reward scale, and ``hidden_sizes`` as ``net_arch``. A resumed
    run continues exactly, including the noise of ``use_sde``, unless the model keeps state outside its
    policy, optimizers and replay buffer.

    Attributes:
        model: DQN, SAC, TD3 or DDPG, or ``package:Class``.
        policy: name of the model's policy.
        action_noise: standard deviation of Gaussian noise on continuous actions, which are scaled to [-1, 1].
        hyperparameters: further parameters of the model's constructor.
    """

    examples = ({}, {"model": "SAC"}, {"model": "TD3", "action_noise": 0.1}, {"model": "DDPG"})
    kind: Literal["sb3"] = "sb3"
    model: str = "DQN"
    policy: str = "MlpPolicy"
    action_noise: NonNegative = 0.0
    hyperparameters: dict[str, Any] = {}

    @property
    def imports(self) -> tuple[str, ...]:
        module, colon, _ = self.model.rpartition(":")
        return (module,) if colon else ()

    def describe(self) -> str:
        return f"{self.model} of Stable-Baselines3, {self.policy}"

    def memory(self, spaces: Spaces, training: Training) -> tuple[MemoryUse, ...]:
        return _replay_and_networks(spaces, training)  # its replay buffer takes about as much memory

    def build(self, spaces: Spaces, training: Training, device: str) -> Algorithm:
        _require_stable_baselines()
        from dockctl.agents.stable_baselines import StableBaselines
        from dockctl.agents.tensors import torch_device

        return StableBaselines(self, spaces, training, torch_device(device))

    def load_policy(self, tensors: Tensors, spaces: Spaces, hidden_sizes: tuple[int, ...]) -> Policy:
        _require_stable_baselines()
        from dockctl.agents.stable_baselines import GreedyPolicy, make_model
        from dockctl.agents.tensors import load_parameters

        given = sum(array.size for array in tensors.values())
        for layers in _layers([list(hidden_sizes), self.hyperparameters.get("policy_kwargs")]):
            if sum(a * b for a, b in pairwise((1, *layers))) > given:  # checked before allocation
                raise ValueError(f"layers of {layers} units need more than {given:,} weights")
        model = make_model(self, spaces, hidden_sizes, buffer_size=1, device="cpu")
        load_parameters(model.policy, tensors)
        return GreedyPolicy(model.policy)


def _layers(value: Any) -> Iterator[list[int]]:
    """Yield every list of integers in a nested value."""
    if isinstance(value, list) and all(isinstance(item, int) for item in value):
        yield value
    elif isinstance(value, dict | list):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _layers(item)


def _require_stable_baselines() -> None:
    if find_spec("stable_baselines3") is None:
        message = "Stable-Baselines3 is not installed: pip install 'dockctl[sb3]'"
        raise DockctlError(f"training.algorithm: {message}", code="unavailable")
