"""Learning algorithms that ``training.algorithm`` selects by `kind`.

    training:
      algorithm: {kind: sb3, model: SAC}

The models here are light; what they build imports torch.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from dockctl.errors import Code, DockctlError
from dockctl.plugins import ALGORITHMS
from dockctl.scenarios.base import NonNegative
from dockctl.scenarios.extensions import Kind, register

if TYPE_CHECKING:
    from gymnasium.spaces import Space

    from dockctl.agents.interface import Algorithm, Policy, Tensors
    from dockctl.scenarios.training import Training


class AlgorithmError(DockctlError):
    """An algorithm that cannot be built.

    Args:
        message: what was found and what is allowed.
        field: path of the key in the scenario.
        code, suggestion: as of `DockctlError`.
    """

    def __init__(
        self,
        message: str,
        field: str = "training.algorithm",
        code: Code = "invalid",
        suggestion: str = "",
    ) -> None:
        super().__init__(message, code=code, suggestion=suggestion)
        self.field = field


class AlgorithmSpec(Kind):
    """A learning algorithm as data. A subclass adds its keys as fields.

    Attributes:
        on_resume: what a resumed training loses, for the user; empty if it continues exactly.
    """

    on_resume: ClassVar[str] = ""

    def build(
        self, observation_space: Space[Any], action_space: Space[Any], training: Training, device: str
    ) -> Algorithm:
        """Return the algorithm for ``training.boats`` boats.

        Args:
            observation_space, action_space: of one boat.
            training: the numbers that all algorithms share.
            device: torch device of the networks.

        Raises:
            AlgorithmError: the algorithm cannot learn in these spaces, or a library is missing.
            DockctlError: the device is not available.
        """
        raise NotImplementedError

    def load_policy(
        self,
        tensors: Tensors,
        observation_space: Space[Any],
        action_space: Space[Any],
        hidden_sizes: tuple[int, ...],
    ) -> Policy:
        """Rebuild the greedy policy from what `Algorithm.policy_tensors` returned.

        Raises:
            KeyError, TypeError, ValueError, RuntimeError: the tensors belong to another network.
            AlgorithmError: a library is missing.
        """
        raise NotImplementedError


@register(ALGORITHMS, source="sections 3.2.4-3.2.6")
class Dqn(AlgorithmSpec):
    """Dueling double DQN with n-step returns; its numbers are the keys of ``training``."""

    kind: Literal["dqn"] = "dqn"

    def build(
        self, observation_space: Space[Any], action_space: Space[Any], training: Training, device: str
    ) -> Algorithm:
        from dockctl.agents.checkpoint import torch_device
        from dockctl.agents.dqn.algorithm import DQN

        size, actions = _discrete(observation_space, action_space)
        return DQN(size, actions, training, torch_device(device))

    def load_policy(
        self,
        tensors: Tensors,
        observation_space: Space[Any],
        action_space: Space[Any],
        hidden_sizes: tuple[int, ...],
    ) -> Policy:
        from dockctl.agents.checkpoint import load_parameters
        from dockctl.agents.dqn.network import DuelingQNetwork, GreedyPolicy

        network = DuelingQNetwork(*_discrete(observation_space, action_space), hidden_sizes)
        load_parameters(network, tensors)
        return GreedyPolicy(network)


def _discrete(observation_space: Space[Any], action_space: Space[Any]) -> tuple[int, int]:
    """Return the length of an observation and the number of actions."""
    from gymnasium.spaces import Box, Discrete

    if not isinstance(observation_space, Box) or len(observation_space.shape) != 1:
        message = f"dqn takes observations that are vectors, not {observation_space}"
        raise AlgorithmError(message, code="mismatch")
    if not isinstance(action_space, Discrete):
        raise AlgorithmError(
            f"dqn needs discrete actions, not {action_space}: use 'actions: {{kind: grid}}', or an"
            " algorithm for continuous actions, such as 'algorithm: {kind: sb3, model: SAC}'",
            "actions",
            "mismatch",
        )
    return observation_space.shape[0], int(action_space.n)


@register(ALGORITHMS, source="https://stable-baselines3.readthedocs.io")
class StableBaselines3(AlgorithmSpec):
    """An off-policy algorithm of Stable-Baselines3, in its own implementation.

    The keys of ``training`` decide whatever both have: seed, learning rate, replay, batch, discount, n-step,
    warm-up, steps per update, epsilon, reward scale, and ``hidden_sizes`` as ``net_arch``. A resumed training
    starts with an empty replay.

    Attributes:
        model: DQN, SAC, TD3 or DDPG, or ``package:Class``.
        policy: name of the model's policy.
        action_noise: standard deviation of Gaussian noise on continuous actions, which are scaled to [-1, 1].
        hyperparameters: further parameters of the model's constructor.
    """

    on_resume: ClassVar[str] = "the replay buffer starts empty"

    kind: Literal["sb3"] = "sb3"
    model: str = "DQN"
    policy: str = "MlpPolicy"
    action_noise: NonNegative = 0.0
    hyperparameters: dict[str, Any] = {}

    def build(
        self, observation_space: Space[Any], action_space: Space[Any], training: Training, device: str
    ) -> Algorithm:
        from dockctl.agents.checkpoint import torch_device

        _require_stable_baselines()
        from dockctl.agents.stable_baselines import StableBaselines

        return StableBaselines(self, observation_space, action_space, training, torch_device(device))

    def load_policy(
        self,
        tensors: Tensors,
        observation_space: Space[Any],
        action_space: Space[Any],
        hidden_sizes: tuple[int, ...],
    ) -> Policy:
        _require_stable_baselines()
        from dockctl.agents.checkpoint import load_parameters
        from dockctl.agents.stable_baselines import GreedyPolicy, make_model

        model = make_model(self, observation_space, action_space, hidden_sizes, buffer_size=1, device="cpu")
        load_parameters(model.policy, tensors)
        return GreedyPolicy(model.policy)


def _require_stable_baselines() -> None:
    if find_spec("stable_baselines3") is None:
        message = "Stable-Baselines3 is not installed: pip install 'dockctl[sb3]'"
        raise AlgorithmError(message, code="unavailable")
