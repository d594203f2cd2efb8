"""Observations and infos of a vector environment with same-step autoreset.

When an episode ends, `step` returns the first observation and info of the next one. Those of the step itself
are in ``info["final_obs"]`` and ``info["final_info"]``; the functions here put them back.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Info = Mapping[str, Any]


def final_observation(observation: NDArray[Any], info: Info, done: NDArray[np.bool_]) -> NDArray[Any]:
    """Return the observations after the step and before any reset, (n, observation_size)."""
    if not done.any():
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
