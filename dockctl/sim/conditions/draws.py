"""Random numbers of the conditions; numba, half a second to import, is loaded on the first call."""

from __future__ import annotations

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
