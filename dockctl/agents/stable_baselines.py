"""Off-policy algorithms of Stable-Baselines3 as an `Algorithm`, driven step by step."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Iterator, Mapping
from functools import partial
from operator import attrgetter
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3
import torch
from gymnasium.spaces import Box
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError
from stable_baselines3.common.buffers import NStepReplayBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import DummyVecEnv

from dockctl.agents.algorithms import StableBaselines3
from dockctl.agents.checkpoint import flatten, nest
from dockctl.agents.interface import Info, Metrics, Policy, Spaces, Step, Tensors
from dockctl.agents.tensors import load_optimizer, load_parameters, numpy_tensors, optimizer_tensors
from dockctl.errors import nearest
from dockctl.scenarios.base import FieldError
from dockctl.scenarios.training import Training


class _EnvOfSpaces(gymnasium.Env[Any, Any]):
    """Only has spaces: the constructors of Stable-Baselines3 read them from an environment."""

    def __init__(self, spaces: Spaces) -> None:
        self.observation_space, self.action_space = spaces


def make_model(
    spec: StableBaselines3,
    spaces: Spaces,
    hidden_sizes: tuple[int, ...],
    boats: int = 1,
    **arguments: Any,
) -> OffPolicyAlgorithm:
    """Construct a model without a usable environment.

    Args:
        arguments: of the constructor; those that the class does not accept are omitted.

    Raises:
        FieldError: class, policy, hyperparameters or spaces are invalid for this model.
    """
    model_class = _model_class(spec.model)
    known = inspect.signature(model_class).parameters
    settings = {name: value for name, value in arguments.items() if name in known}
    for name, value in spec.hyperparameters.items():
        field = f"training.algorithm.hyperparameters.{name}"
        if name not in known:
            message = f"{spec.model} has no such parameter"
            raise FieldError(field, message, "unknown_key", nearest(name, known))
        if name in SHARED:
            raise FieldError(field, f"is set by {SHARED[name]}")
        try:
            _type_of(known[name]).validate_python(value, strict=True)
        except ValidationError as error:
            raise FieldError(field, error.errors()[0]["msg"], "wrong_type") from None
    network = {"net_arch": list(hidden_sizes), **(spec.hyperparameters.get("policy_kwargs") or {})}
    if spec.policy not in model_class.policy_aliases:
        names = sorted(model_class.policy_aliases)
        message = f"{spec.model} has no policy '{spec.policy}' (known: {', '.join(names)})"
        raise FieldError("training.algorithm.policy", message, "unknown_name", nearest(spec.policy, names))
    environment = DummyVecEnv([partial(_EnvOfSpaces, spaces)] * boats)
    try:
        model: OffPolicyAlgorithm = model_class(
            spec.policy, environment, **{**settings, **spec.hyperparameters, "policy_kwargs": network}
        )
    except (AssertionError, NotImplementedError, TypeError, ValueError) as error:  # the library's checks
        reason = " ".join(str(error).split())
        message = f"{spec.model} cannot be built: {reason}"
        raise FieldError("training.algorithm", message, "mismatch") from None
    return model


SHARED = {
    "env": "the scenario",
    "seed": "training.seed",
    "device": "--device",
    "learning_rate": "training.learning_rate and final_learning_rate",
    "buffer_size": "training.replay_capacity",
    "learning_starts": "training.warmup_steps",
    "batch_size": "training.batch_size",
    "gamma": "training.gamma",
    "n_steps": "training.n_step",
    "train_freq": "training.steps_per_update",
    "gradient_steps": "training.steps_per_update",
    "action_noise": "training.algorithm.action_noise",
    "exploration_initial_eps": "training.epsilon.start",
    "exploration_final_eps": "training.epsilon.end",
    "exploration_fraction": "training.epsilon.decay_steps",
    "policy": "training.algorithm.policy",
}
"""Constructor parameters that other keys of the scenario set."""


def _model_class(name: str) -> Any:
    module, _, attribute = name.rpartition(":")
    try:
        found = getattr(importlib.import_module(module) if module else stable_baselines3, attribute)
    except (ImportError, AttributeError):
        known = sorted(n for n, value in vars(stable_baselines3).items() if _is_off_policy(value))
        message = f"no algorithm '{name}': expected {', '.join(known)}, or package:Class"
        raise FieldError("training.algorithm.model", message, "unknown_name", nearest(name, known)) from None
    if not _is_off_policy(found):
        message = f"'{name}' is not an off-policy algorithm of Stable-Baselines3"
        raise FieldError("training.algorithm.model", message)
    return found


def _type_of(parameter: inspect.Parameter) -> TypeAdapter[Any]:
    """Return the validator of a parameter's type; it accepts anything if the type is unknown."""
    annotation = parameter.annotation
    known = annotation is not inspect.Parameter.empty and not isinstance(annotation, str)
    return TypeAdapter(annotation if known else Any, config=ConfigDict(arbitrary_types_allowed=True))


def _is_off_policy(value: object) -> bool:
    return inspect.isclass(value) and issubclass(value, OffPolicyAlgorithm)


class GreedyPolicy(Policy):
    """The deterministic actions of a Stable-Baselines3 policy."""

    def __init__(self, policy: BasePolicy) -> None:
        torch.set_num_threads(1)  # the matrices are small, and the simulator uses the other cores
        self.policy = policy

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action for each boat; see `Policy`."""
        return np.asarray(self.policy.predict(observation, deterministic=True)[0])


class StableBaselines:
    """Drives a model: its own exploration, replay buffer and gradient steps, stepped by the trainer.

    Args:
        spec: class, policy, hyperparameters and action noise.
        spaces: of one boat.
        training: the hyperparameters that all algorithms share.
        device: of the networks.
    """

    def __init__(
        self,
        spec: StableBaselines3,
        spaces: Spaces,
        training: Training,
        device: torch.device,
    ) -> None:
        epsilon, boats = training.epsilon, training.boats
        noise = None
        if spec.action_noise and isinstance(spaces.action, Box):
            shape = (boats, *spaces.action.shape)
            noise = NormalActionNoise(np.zeros(shape), np.full(shape, spec.action_noise))
        self.training = training
        self.model = make_model(
            spec, spaces, training.hidden_sizes, boats,
            seed=training.seed,
            device=device,
            learning_rate=lambda remaining: training.learning_rate_at((1 - remaining) * training.total_steps),
            buffer_size=training.replay_capacity,
            batch_size=training.batch_size,
            gamma=training.gamma,
            n_steps=training.n_step,
            action_noise=noise,
            exploration_initial_eps=epsilon.start,
            exploration_final_eps=epsilon.end,
            exploration_fraction=min(1.0, epsilon.decay_steps / training.total_steps),
        )  # fmt: skip
        self.model.set_logger(Logger(None, []))  # `configure` would create a folder
        self.policy = GreedyPolicy(self.model.policy)

    @property
    def updates(self) -> int:
        return self.model._n_updates

    @property
    def epsilon(self) -> float | None:
        rate: float | None = getattr(self.model, "exploration_rate", None)
        return rate

    def act(self, observation: NDArray[Any], env_steps: int) -> NDArray[Any]:
        """Return the model's exploratory actions; see `Algorithm`."""
        model = self.model
        model.num_timesteps, model._last_obs = env_steps, observation
        model._update_current_progress_remaining(env_steps, self.training.total_steps)
        model._on_step()  # exploration rate, and target network of DQN
        action, self._buffer_action = model._sample_action(
            self.training.warmup_steps, model.action_noise, self.training.boats
        )
        return action

    def store(self, step: Step) -> None:
        """Store a step with its scaled reward; see `Algorithm`."""
        timeouts, replay = step.truncated & ~step.terminated, self.model.replay_buffer
        assert replay is not None
        if isinstance(replay, NStepReplayBuffer) and replay.size():
            # After a rollback, new episodes follow. N-step returns must not continue in them.
            last = replay.pos - 1
            follows = (replay.next_observations[last] == step.observation).all(axis=1)
            replay.timeouts[last] = np.maximum(replay.timeouts[last], ~follows & (replay.dones[last] == 0))
        replay.add(
            step.observation,
            step.next_observation,
            self._buffer_action,
            step.reward * self.training.reward_scale,
            step.terminated | step.truncated,
            [{"TimeLimit.truncated": bool(timeout)} for timeout in timeouts],
        )

    def learn(self, env_steps: int) -> Iterator[Metrics]:
        """Perform the updates due after `env_steps`, one at a time; see `Algorithm`."""
        training, model, replay = self.training, self.model, self.model.replay_buffer
        assert replay is not None
        if replay.size() * training.boats < min(training.warmup_steps, replay.buffer_size * training.boats):
            return
        before = training.updates_due(env_steps - training.boats)
        for _ in range(training.updates_due(env_steps) - before):
            model.train(1, training.batch_size)
            logged = model.logger.name_to_value
            metrics = {name.removeprefix("train/"): float(value) for name, value in logged.items()}
            model.logger.dump()
            del metrics["n_updates"]
            yield {"loss": metrics.get("critic_loss", np.nan), **metrics}

    def policy_tensors(self) -> Tensors:
        """Return the state of the model's policy; see `Algorithm`."""
        return numpy_tensors(self.model.policy.state_dict())

    def state(self) -> tuple[Tensors, dict[str, Any]]:
        """Return optimizers, other variables, the replay buffer, and the generators; see `Algorithm`.

        Stable-Baselines3 draws from the global generators of NumPy and torch and from the action space's.
        """
        (optimizers, variables), replay = self._parts(), self.model.replay_buffer
        assert replay is not None
        numpy_state = np.random.get_state(legacy=False)
        tensors = {name: optimizer_tensors(optimizer) for name, optimizer in optimizers.items()}
        tensors["variables"] = numpy_tensors(variables)
        # With `optimize_memory_usage`, row `pos` holds the next observation.
        rows = replay.buffer_size if replay.full else replay.pos + 1
        tensors["replay"] = {name: array[:rows] for name, array in self._replay_arrays().items()}
        tensors["random"] = {"torch": torch.get_rng_state().numpy(), "numpy": numpy_state["state"]["key"]}
        facts = {
            "updates": self.updates,
            "calls": getattr(self.model, "_n_calls", 0),
            "replay": {"pos": replay.pos, "full": replay.full},
            "numpy": {**numpy_state, "state": {"pos": numpy_state["state"]["pos"]}},
            "action_space": self.model.action_space.np_random.bit_generator.state,
        }
        return flatten(tensors, "/"), facts

    def _replay_arrays(self) -> dict[str, NDArray[Any]]:
        buffer = vars(self.model.replay_buffer)
        return {name: value for name, value in buffer.items() if isinstance(value, np.ndarray)}

    def _parts(self) -> tuple[dict[str, torch.optim.Optimizer], dict[str, torch.Tensor]]:
        """Return the model's optimizers and its other variables, by name."""
        modules, variables = self.model._get_torch_save_params()
        optimizers = {name: attrgetter(name)(self.model) for name in modules if name.endswith("optimizer")}
        if self.model.use_sde:  # the noise of state-dependent exploration is not a parameter
            noise = "actor.action_dist.exploration_"
            variables = [*variables, f"{noise}mat", f"{noise}matrices"]
        return optimizers, {name: attrgetter(name)(self.model) for name in variables}

    def restore(self, policy: Tensors, tensors: Tensors, facts: Mapping[str, Any]) -> None:
        """Continue from a saved state; see `Algorithm`."""
        load_parameters(self.model.policy, policy)
        (optimizers, variables), nested, replay = self._parts(), nest(tensors, "/"), self.model.replay_buffer
        assert replay is not None
        for name, optimizer in optimizers.items():
            load_optimizer(optimizer, nested[name])
        for name, variable in variables.items():
            variable.data.copy_(torch.from_numpy(nested["variables"][name]))
        self.model._n_updates = facts["updates"]
        setattr(self.model, "_n_calls", facts["calls"])  # noqa: B010  # only DQN has it
        replay.pos, replay.full = facts["replay"]["pos"], facts["replay"]["full"]
        for name, array in self._replay_arrays().items():
            saved = nested["replay"][name]
            array[: len(saved)] = saved
        key = {"key": nested["random"]["numpy"], **facts["numpy"]["state"]}
        np.random.set_state({**facts["numpy"], "state": key})
        torch.set_rng_state(torch.from_numpy(nested["random"]["torch"]))
        self.model.action_space.np_random.bit_generator.state = facts["action_space"]
