"""What the learner reads from a vector environment with same-step autoreset.

When an episode ends, `step` returns the first observation and info of the next one; those of the
step just made are in ``info["final_obs"]`` and ``info["final_info"]``. The functions here put them back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Info = Mapping[str, Any]


def settled_observation(observation: NDArray[Any], info: Info, done: NDArray[np.bool_]) -> NDArray[Any]:
    """Observations after the step and before any reset, (n, observation_size)."""
    if not done.any():
        return observation
    settled = observation.copy()
    settled[done] = np.stack(list(info["final_obs"][done]))
    return settled


def settled_info(info: Info, done: NDArray[np.bool_]) -> Info:
    """Info of the step just made: finished rows come from ``final_info``."""
    return _overlay(info, info["final_info"], done) if done.any() else info


def _overlay(info: Info, final: Info, done: NDArray[np.bool_]) -> dict[str, Any]:
    settled: dict[str, Any] = {}
    for key, last in final.items():
        if isinstance(last, Mapping):
            settled[key] = _overlay(info.get(key, {}), last, done)
        else:
            rows = np.broadcast_to(done.reshape(-1, *[1] * (np.ndim(last) - 1)), np.shape(last))
            settled[key] = np.where(rows, last, info.get(key, last))
    return settled
