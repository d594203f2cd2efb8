"""Policies from third-party code: factories, Stable-Baselines3 archives and ONNX files."""

from __future__ import annotations

import importlib
import inspect
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Discrete, Space
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy, QPolicy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, nearest, plugin_errors, require_shape
from dockctl.onnx_networks import OnnxNetworks, description, open_session
from dockctl.scenarios.schema import Scenario


class CheckedPolicy:
    """Wraps a policy: reports where its errors come from, and checks its actions against the action space."""

    def __init__(self, policy: Policy, name: str, file: Path | None, space: Space[Any]) -> None:
        self._policy, self._name, self._file, self._space = policy, name, file, space
        if isinstance(policy, QPolicy) and isinstance(space, Discrete):  # only then is this one, too
            self.q_values = partial(self._q_values, policy, int(space.n))

    def reset(self, rows: NDArray[np.int64], info: Info) -> None:
        with plugin_errors(f"policy {self._name}: reset fails", self._file):
            self._policy.reset(rows, info)

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        with plugin_errors(f"policy {self._name}: act fails", self._file):
            actions = np.asarray(self._policy.act(observation, info))
        shape, dtype = (len(observation), *(self._space.shape or ())), np.dtype(self._space.dtype)
        if actions.shape == shape and np.can_cast(actions.dtype, dtype, "same_kind"):
            actions = actions.astype(dtype)
            if all(map(self._space.contains, actions)):
                return actions
        raise DockctlError(
            f"policy {self._name}: act returned actions of shape {actions.shape} and type {actions.dtype}:"
            f" {np.array2string(actions.ravel()[:4])}; expected shape {shape} with rows in {self._space}",
            code="plugin",
        )

    def _q_values(self, policy: QPolicy, actions: int, observation: NDArray[Any]) -> NDArray[np.float32]:
        with plugin_errors(f"policy {self._name}: q_values fails", self._file):
            values = np.asarray(policy.q_values(observation), np.float32)
        require_shape(f"policy {self._name}: q_values", values.shape, (len(observation), actions))
        return values


def imported(module: str, given: str) -> ModuleType:
    """Import a module; `given` is what the user wrote, for errors.

    Raises:
        PluginError: it cannot be imported.
    """
    with plugin_errors(f"policy {given}: module '{module}' cannot be imported"):
        return importlib.import_module(module)


def factory_of(module: ModuleType, name: str, given: str) -> Callable[[Scenario], Any]:
    """Return the factory `name` of a module.

    Raises:
        DockctlError: there is none, or it cannot be called.
    """
    factory = getattr(module, name, None)
    if callable(factory):
        return cast("Callable[[Scenario], Any]", factory)
    known = [
        key for key, value in vars(module).items() if callable(value) and value.__module__ == module.__name__
    ]
    what = "is not callable" if hasattr(module, name) else "does not exist"
    raise DockctlError(
        f"{given}: the factory '{name}' {what} (known: {', '.join(known) or 'none'})",
        code="unknown_name",
        suggestion=nearest(name, known),
    )


def sb3_policy(file: Path, algorithm: str, env: DockingVectorEnv) -> Policy:
    """Load a Stable-Baselines3 archive; its pickles can run code.

    Args:
        algorithm: class in Stable-Baselines3, which the file does not state.

    Raises:
        DockctlError: Stable-Baselines3 is missing or has no such class, or the model does not match `env`.
    """
    try:
        import stable_baselines3
        from stable_baselines3.common.base_class import BaseAlgorithm

        from dockctl.agents.stable_baselines import GreedyPolicy
    except ImportError:
        raise DockctlError(
            f"{file}: needs Stable-Baselines3; install it with: pip install 'dockctl[sb3]'",
            code="unavailable",
        ) from None
    classes = {
        name: value
        for name, value in vars(stable_baselines3).items()
        if inspect.isclass(value) and issubclass(value, BaseAlgorithm)
    }
    if algorithm not in classes:
        listed = ", ".join(sorted(classes))
        raise DockctlError(
            f"{file}: unknown algorithm '{algorithm}' (known: {listed})",
            code="unknown_name",
            suggestion=nearest(algorithm, classes),
        )
    model = classes[algorithm].load(file, device="cpu")
    _require_same(file, "observations", model.observation_space.shape, env.single_observation_space.shape)
    if model.action_space != env.single_action_space:
        _require_same(file, "actions", model.action_space, env.single_action_space)
    return GreedyPolicy(model.policy)


def onnx_policy(file: Path, env: DockingVectorEnv) -> Policy:
    """Load an ONNX model: one input, observations (n, k), and action values (n, actions) as its first output.

    A model from ``dockctl export`` takes observations in physical units and chooses the actions itself.

    Raises:
        DockctlError: ONNX Runtime is not installed, or the model does not match the spaces of `env`.
    """
    try:
        session = open_session(str(file))
    except ImportError:
        raise DockctlError(
            f"{file}: needs ONNX Runtime; install it with: pip install 'dockctl[onnx]'", code="unavailable"
        ) from None
    space, size = env.single_action_space, (env.single_observation_space.shape or (0,))[0]
    if not isinstance(space, Discrete):
        raise DockctlError(
            f"{file}: outputs action values, but '{env.scenario.name}' has the actions {space}",
            code="mismatch",
        )
    if text := description(session):
        networks = OnnxNetworks(session, json.loads(text))
        _require_same(file, "observations and actions", networks.sizes, (size, int(space.n)))
        return _ExportedPolicy(networks)
    policy = _OnnxPolicy(session, file, size)
    shape = policy.values(np.zeros((1, policy.size))).shape
    _require_same(file, "action values", shape, (1, int(space.n)))
    return policy


class _ExportedPolicy(Policy):
    """The greedy policy of a model from ``dockctl export``, which chooses the actions itself."""

    def __init__(self, networks: OnnxNetworks) -> None:
        self.networks = networks

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action (n,) for each boat."""
        return self.networks.greedy(observation, observation)


class _OnnxPolicy(Policy):
    """The greedy policy of an ONNX model that outputs action values.

    Raises:
        DockctlError: the model has several inputs, or its observations do not have `size` columns.
    """

    def __init__(self, session: Any, file: Path, size: int) -> None:
        self.session, self.size = session, size
        names = [given.name for given in session.get_inputs()]
        if len(names) != 1:
            raise DockctlError(
                f"{file}: has the inputs {', '.join(names)}; expected one, the observation", code="mismatch"
            )
        self.name, shape = names[0], session.get_inputs()[0].shape
        self.output = session.get_outputs()[0].name
        if len(shape) != 2 or (isinstance(shape[1], int) and shape[1] != size):
            _require_same(file, "observations", shape, ["n", size])
        self.one_by_one = isinstance(shape[0], int)  # the file fixes the batch size; 1 is assumed

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action (n,) for each boat."""
        return np.asarray(self.values(observation).argmax(axis=1))

    def values(self, observation: NDArray[Any]) -> NDArray[Any]:
        """Return the action values (n, actions) of observations (n, size)."""
        given = observation.astype(np.float32)
        batches = given[:, None] if self.one_by_one else given[None]
        return np.concatenate([self.session.run([self.output], {self.name: batch})[0] for batch in batches])


def _require_same(file: Path, what: str, found: Any, expected: Any) -> None:
    if found != expected:
        raise DockctlError(
            f"{file}: the policy has {what} {found}, but the scenario has {expected}", code="mismatch"
        )
