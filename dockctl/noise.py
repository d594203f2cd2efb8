"""Random numbers that depend only on a seed and an index, so that each can be drawn without the others.

The bits are those of SplitMix64 (Steele, Lea, Flood 2014, "Fast splittable pseudorandom number generators"),
whose state is a multiple of the index. A normal number is made from two uniform ones (Box and Muller 1958).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import compiled
from dockctl.geometry import Floats, Ints

Seeds = NDArray[np.uint64]

STEP = np.uint64(0x9E3779B97F4A7C15)
FIRST, SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
A, B, C, TO_UNIT = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
UNIT = 2.0**-53


@compiled()
def bits(seed: int | np.uint64, index: int) -> np.uint64:
    """Return 64 random bits."""
    z = np.uint64(seed) + (np.uint64(index) + np.uint64(1)) * STEP
    z = (z ^ (z >> A)) * FIRST
    z = (z ^ (z >> B)) * SECOND
    return z ^ (z >> C)


@compiled()
def uniform(seed: int | np.uint64, index: int) -> float:
    """Return a random number, uniform over [0, 1)."""
    return float(bits(seed, index) >> TO_UNIT) * UNIT


@compiled()
def normal(seed: int | np.uint64, index: int) -> float:
    """Return a standard normal random number."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(seed, 2 * index)))
    return radius * math.cos(2.0 * math.pi * uniform(seed, 2 * index + 1))


@compiled(inline="always")
def may_exceed(seed: int | np.uint64, index: int, share: float) -> bool:
    """Return whether the magnitude of a `normal` number may exceed sqrt(-2 ln share), from half of its bits.

    It is at most sqrt(-2 ln u) with the uniform number u of its radius, so most need no second draw.
    """
    return 1.0 - uniform(seed, 2 * index) <= share


@compiled()
def normals(seeds: Seeds, index: Ints, count: int) -> Floats:
    """Return `count` standard normal numbers, starting at `index` (n,), for each of n seeds, (n, count)."""
    numbers = np.empty((len(seeds), count))
    for row in range(len(seeds)):
        for k in range(count):
            numbers[row, k] = normal(seeds[row], index[row] + k)
    return numbers


@compiled()
def derived_seeds(seeds: Seeds, index: Ints) -> Seeds:
    """Return a new seed for each seed and index (n,)."""
    derived = np.empty(len(seeds), np.uint64)
    for row in range(len(seeds)):
        derived[row] = bits(seeds[row], index[row])
    return derived


@compiled()
def uniforms(seeds: Seeds, count: int) -> Floats:
    """Return the first `count` uniform numbers of n seeds, (n, count)."""
    numbers = np.empty((len(seeds), count))
    for row in range(len(seeds)):
        for k in range(count):
            numbers[row, k] = uniform(seeds[row], k)
    return numbers
