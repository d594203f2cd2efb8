"""Noise of the LiDAR returns: range errors, and lost returns.

The noise of a ray depends only on the scan's seed and the ray's index, so that it is the same
whether all rays are traced or only some.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dockctl.compute import compiled
from dockctl.geometry import Floats
from dockctl.noise import may_exceed, normal, uniform
from dockctl.sim.lidar.height_grid import SLACK_M
from dockctl.sim.lidar.raycast import MISS

MOST_SIGMAS = 5.0
"""Larger errors, 6e-7 of all, are clipped."""


class ReturnNoise(NamedTuple):
    """Noise of the returns of one scan: seed, standard deviation [m], share of lost returns."""

    seed: np.uint64
    sigma_m: float
    lost: float


@compiled(inline="always")
def largest_error(noise: ReturnNoise | None) -> float:
    """Return an upper bound on the size of a range error [m], with a margin for rounding errors."""
    return 0.0 if noise is None else MOST_SIGMAS * noise.sigma_m + SLACK_M


@compiled(inline="always")
def return_error(noise: ReturnNoise, ray: int) -> float:
    """Return the error of a ray's range [m], infinite if its return is lost."""
    if noise.lost > 0.0 and uniform(noise.seed + np.uint64(1), ray) < noise.lost:
        return MISS
    return noise.sigma_m * min(max(normal(noise.seed, ray), -MOST_SIGMAS), MOST_SIGMAS)


@compiled(inline="always")
def share_above(noise: ReturnNoise, error_m: float) -> float:
    """Return the share for `may_exceed` of errors above a size [m]; 1 if it is negative."""
    sigmas = max(0.0, error_m - SLACK_M) / max(noise.sigma_m, SLACK_M * SLACK_M)
    return math.exp(-0.5 * sigmas * sigmas)


@compiled(inline="always")
def error_above(noise: ReturnNoise | None, ray: int, share: float) -> float:
    """Return the error of a ray's range [m]; infinite if it is lost, or certainly too small for the share."""
    if noise is None:
        return 0.0
    return return_error(noise, ray) if may_exceed(noise.seed, ray, share) else MISS


@compiled()
def noisy_hits(hits: Floats, seed: int, sigma_m: float, lost: float) -> Floats:
    """Return the ray parameters (k,) of a full scan with noise; infinite where there is no return."""
    noise = ReturnNoise(np.uint64(seed), sigma_m, lost)
    noisy = np.empty_like(hits)
    for ray in range(len(hits)):
        noisy[ray] = max(0.0, hits[ray] + return_error(noise, ray))
    return noisy
