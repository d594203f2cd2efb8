"""Random numbers of the conditions; numba, half a second to import, is loaded on the first call."""

from __future__ import annotations

import math

import numpy as np

from dockctl.geometry import Floats, Ints


def draw_seed(rng: np.random.Generator) -> np.uint64:
    """Return a seed drawn from a generator."""
    return np.uint64(rng.integers(2**63))


def normals(seeds: np.ndarray, index: Ints, count: int) -> Floats:
    """See `dockctl.noise.normals`."""
    from dockctl import noise

    return noise.normals(seeds, index, count)


def derived_seeds(seeds: np.ndarray, index: Ints) -> np.ndarray:
    """See `dockctl.noise.derived_seeds`."""
    from dockctl import noise

    return noise.derived_seeds(seeds, index)


def gauss_markov(value: Floats, noise: Floats, period_s: float, time_s: float) -> Floats:
    """Return the next value of a first-order Gauss-Markov process with a time constant.

    Args:
        value: now, of any shape.
        noise: normal, of the same shape, with the standard deviation of the process.
    """
    kept = math.exp(-period_s / time_s)
    return kept * value + math.sqrt(1 - kept**2) * noise
