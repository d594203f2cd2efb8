"""Policies from third-party code: factories, Stable-Baselines3 archives and ONNX files."""

from __future__ import annotations

import importlib
import inspect
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import numpy as np
from gymnasium.spaces import Discrete, Space
from numpy.typing import NDArray

from dockctl.agents.interface import Info, Policy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, nearest, plugin_errors
from dockctl.geometry import Floats
from dockctl.scenarios.schema import Scenario


class CheckedPolicy:
    """Wraps a policy: locates its errors and checks its actions against the action space."""

    def __init__(self, policy: Policy, name: str, file: Path | None, space: Space[Any]) -> None:
        self._policy, self._name, self._file, self._space = policy, name, file, space

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
        algorithm: class of Stable-Baselines3, which the file does not name.

    Raises:
        DockctlError: Stable-Baselines3 is not installed, has no such class, or the model does not fit `env`.
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

    A model of ``dockctl export`` takes the observations in units and has an output of that name.

    Raises:
        DockctlError: ONNX Runtime is not installed, or the model does not fit the spaces of `env`.
    """
    try:
        import onnxruntime
    except ImportError:
        raise DockctlError(
            f"{file}: needs ONNX Runtime; install it with: pip install 'dockctl[onnx]'", code="unavailable"
        ) from None
    space = env.single_action_space
    if not isinstance(space, Discrete):
        raise DockctlError(
            f"{file}: outputs action values, but '{env.scenario.name}' has the actions {space}",
            code="mismatch",
        )
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    policy = _OnnxPolicy(session, file, (env.single_observation_space.shape or (0,))[0])
    shape = policy.values(np.zeros((1, policy.size))).shape
    _require_same(file, "action values", shape, (1, int(space.n)))
    return policy


class _OnnxPolicy(Policy):
    """The greedy policy of an ONNX model of action values.

    Raises:
        DockctlError: the model has several inputs, or its observations do not have `size` numbers.
    """

    def __init__(self, session: Any, file: Path, size: int) -> None:
        self.session, self.size = session, size
        names = [given.name for given in session.get_inputs()]
        if len(names) != 1:
            raise DockctlError(
                f"{file}: has the inputs {', '.join(names)}; expected one, the observation", code="mismatch"
            )
        self.name, shape = names[0], session.get_inputs()[0].shape
        outputs = [given.name for given in session.get_outputs()]
        self.exported = {"action", "q_values"} <= {*outputs}  # by dockctl: it chooses the action
        self.output = "q_values" if "q_values" in outputs else outputs[0]
        self.scale = _scale_of(session, size)
        if len(shape) != 2 or (isinstance(shape[1], int) and shape[1] != size):
            _require_same(file, "observations", shape, ["n", size])
        self.one_by_one = isinstance(shape[0], int)  # the file fixes the batch size; 1 is assumed

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        """Return an action (n,) for each boat."""
        if self.exported:
            return self._run("action", observation)
        return np.asarray(self.values(observation).argmax(axis=1))

    def values(self, observation: NDArray[Any]) -> NDArray[Any]:
        """Return the action values (n, actions) of observations (n, size)."""
        return self._run(self.output, observation)

    def _run(self, output: str, observation: NDArray[Any]) -> NDArray[Any]:
        raw = (observation * self.scale).astype(np.float32)
        batches = raw[:, None] if self.one_by_one else raw[None]
        return np.concatenate([self.session.run([output], {self.name: batch})[0] for batch in batches])


def _scale_of(session: Any, size: int) -> Floats:
    """Return what a model of ``dockctl export`` divides observations by, (size,); 1 for other models."""
    try:
        facts = json.loads(session.get_modelmeta().custom_metadata_map["description"])
        scale = np.array([column["scale"] for column in facts["observation"]], float)
    except (KeyError, TypeError, ValueError):
        return np.ones(size)
    return scale if scale.shape == (size,) else np.ones(size)


def _require_same(file: Path, what: str, found: Any, expected: Any) -> None:
    if found != expected:
        raise DockctlError(
            f"{file}: the policy has {what} {found}, but the scenario has {expected}", code="mismatch"
        )
