"""Random numbers by seed and index: known bits, the distribution, and no dependence between indices."""

from __future__ import annotations

import numpy as np
from scipy import stats

from dockctl.noise import bits, derived_seeds, normals, uniform, uniforms


def test_the_bits_are_those_of_splitmix64() -> None:
    """The first outputs of the reference implementation by Vigna for the seed 1234567."""
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    assert [int(bits(np.uint64(1234567), i)) for i in range(4)] == expected


def test_normal_numbers_are_normal_and_independent() -> None:
    seeds = np.arange(2000, dtype=np.uint64)  # neighbors: the worst seeds
    numbers = normals(seeds, np.zeros(2000, np.int64), 100)
    assert stats.kstest(numbers.ravel(), "norm").pvalue > 0.01
    for other in (numbers[:, 1:] * numbers[:, :-1], numbers[1:] * numbers[:-1]):
        assert abs(other.mean()) < 4 / np.sqrt(other.size)
    assert np.array_equal(normals(seeds, np.full(2000, 40), 60), numbers[:, 40:])


def test_uniform_numbers_are_in_their_interval() -> None:
    seeds = derived_seeds(np.arange(500, dtype=np.uint64), np.arange(500))
    numbers = uniforms(seeds, 10)
    assert stats.kstest(numbers.ravel(), "uniform").pvalue > 0.01
    assert numbers[3, 7] == uniform(seeds[3], 7)
    assert len({*seeds.tolist()}) == 500
