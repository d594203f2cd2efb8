"""Policies of other libraries: Stable-Baselines3 archives and ONNX files."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from dockctl.agents.policy import Info, Policy
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError, nearest


class PolicyError(DockctlError):
    """A policy that cannot be loaded, or that does not fit the scenario."""

    code = "mismatch"


class _Predictor:
    """A stateless policy of another library, (n, observation_size) to n actions."""

    def __init__(self, predict: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
        self._predict = predict

    def reset(self, rows: NDArray[np.int64], info: Info) -> None:
        """Do nothing: the policy keeps no state."""

    def act(self, observation: NDArray[Any], info: Info) -> NDArray[Any]:
        return self._predict(observation)


def sb3_policy(file: Path, algorithm: str, env: DockingVectorEnv) -> Policy:
    """Load a Stable-Baselines3 archive, which runs code of its pickles; hence its class is named."""
    try:
        import stable_baselines3
        from stable_baselines3.common.base_class import BaseAlgorithm
    except ImportError:
        raise PolicyError(
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
        raise PolicyError(
            f"{file}: unknown algorithm '{algorithm}' (known: {listed})",
            code="unknown_name",
            suggestion=nearest(algorithm, classes),
        )
    model = classes[algorithm].load(file, device="cpu")
    _require_same(file, "observations", model.observation_space.shape, env.single_observation_space.shape)
    if model.action_space != env.single_action_space:
        _require_same(file, "actions", model.action_space, env.single_action_space)
    return _Predictor(lambda observation: model.predict(observation, deterministic=True)[0])


def onnx_policy(file: Path, env: DockingVectorEnv) -> Policy:
    """Load an ONNX model: one input, observations (n, k), and one output, action values (n, actions)."""
    try:
        import onnxruntime
    except ImportError:
        raise PolicyError(
            f"{file}: needs ONNX Runtime; install it with: pip install 'dockctl[onnx]'", code="unavailable"
        ) from None
    space = env.single_action_space
    if not isinstance(space, Discrete):
        raise PolicyError(f"{file}: gives action values, but '{env.scenario.name}' has the actions {space}")
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    if len(session.get_inputs()) != 1:
        names = ", ".join(one.name for one in session.get_inputs())
        raise PolicyError(f"{file}: has the inputs {names}; expected one, the observation")
    given = session.get_inputs()[0]
    size = (env.single_observation_space.shape or (0,))[0]
    if len(given.shape) != 2 or (isinstance(given.shape[1], int) and given.shape[1] != size):
        _require_same(file, "observations", given.shape, ["n", size])
    # A batch size that is fixed in the file is 1: then one row at a time.
    fixed = isinstance(given.shape[0], int)

    def values(observation: NDArray[Any]) -> NDArray[Any]:
        batches = observation[:, None] if fixed else observation[None]
        outputs = [session.run(None, {given.name: batch.astype(np.float32)})[0] for batch in batches]
        return np.concatenate(outputs)

    shape = values(np.zeros((1, size))).shape
    _require_same(file, "action values", shape, (1, int(space.n)))
    return _Predictor(lambda observation: values(observation).argmax(axis=1))


def _require_same(file: Path, what: str, found: Any, expected: Any) -> None:
    if found != expected:
        raise PolicyError(f"{file}: the policy has {what} {found}, but the scenario has {expected}")
