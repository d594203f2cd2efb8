"""Paired differences against published numbers, scipy, and brute force over every possible table."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from dockctl.analysis import paired
from dockctl.analysis.paired import mcnemar_p, mean_difference, success_difference

Bools = NDArray[np.bool_]
counts = st.integers(0, 60)


def table(both: int, only_first: int, only_second: int, neither: int) -> tuple[Bools, Bools]:
    """Successes of the first and of the second with these counts."""
    first = np.repeat([True, True, False, False], [both, only_first, only_second, neither])
    second = np.repeat([True, False, True, False], [both, only_first, only_second, neither])
    return first, second


@pytest.mark.parametrize(
    ("cells", "value", "low", "high"),
    [
        # Cavo et al. (2012), as in Fagerland, Lydersen and Laake, Statistical Analysis of Contingency Tables
        ((59, 16, 6, 80), -0.0621, -0.1186, -0.0046),
    ],
)
def test_published_intervals(cells: tuple[int, ...], value: float, low: float, high: float) -> None:
    difference = success_difference(*table(*cells))
    assert (difference.value, difference.low, difference.high) == pytest.approx((value, low, high), abs=6e-5)
    assert (difference.pairs, difference.is_clear) == (161, True)


@given(counts, counts, counts, counts)
def test_the_interval_holds_the_difference_and_turns_with_the_order(a: int, b: int, c: int, d: int) -> None:
    if a + b + c + d == 0:
        return
    first, second = table(a, b, c, d)
    there, back = success_difference(first, second), success_difference(second, first)
    assert -1 - 1e-12 <= there.low <= there.value <= there.high <= 1 + 1e-12
    assert (there.low, there.value, there.high) == pytest.approx((-back.high, -back.value, -back.low))


@pytest.mark.parametrize(
    ("chances", "most"),
    [((0.7, 0.2, 0.05, 0.05), 0.97), ((0.4, 0.1, 0.3, 0.2), 0.97), ((0.9, 0.04, 0.04, 0.02), 1.0)],
)
def test_it_covers_the_truth_as_often_as_it_says(chances: tuple[float, ...], most: float) -> None:
    """Summed over every table of 30 episodes with its probability; with rare failures it is cautious."""
    n, truth, covered = 30, chances[2] - chances[1], 0.0
    for a, b, c in product(range(n + 1), repeat=3):
        if a + b + c <= n and (weight := stats.multinomial.pmf([a, b, c, n - a - b - c], n, chances)) > 1e-7:
            interval = success_difference(*table(a, b, c, n - a - b - c))
            covered += weight * (interval.low <= truth <= interval.high)
    assert 0.94 <= covered <= most


@given(counts, counts)
def test_mcnemar_is_the_exact_binomial_test(only_first: int, only_second: int) -> None:
    first, second = table(3, only_first, only_second, 2)
    trials = only_first + only_second
    expected = stats.binomtest(only_first, trials).pvalue if trials else 1.0
    assert mcnemar_p(first, second) == pytest.approx(expected)


def test_mcnemar_bears_many_episodes() -> None:
    first, second = table(0, 30_000, 31_000, 0)
    assert mcnemar_p(first, second) == pytest.approx(stats.binomtest(30_000, 61_000).pvalue)


def test_the_bootstrap_agrees_with_every_possible_resample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paired, "RESAMPLES", 40_000)
    first, second = np.array([1.0, 2.0, 4.0, 8.0, 3.0]), np.array([2.0, 2.5, 3.0, 12.0, 5.0])
    change = second - first
    means = [np.mean(change[list(drawn)]) for drawn in product(range(5), repeat=5)]
    low, high = np.quantile(means, [0.025, 0.975])
    difference = mean_difference(first, second)
    assert difference is not None
    assert difference.value == pytest.approx(change.mean())
    assert (difference.low, difference.high) == pytest.approx((low, high), abs=0.05)


def test_the_bootstrap_agrees_with_scipy() -> None:
    rng = np.random.default_rng(5)
    first = rng.gamma(2, 10, 80)
    second = first + rng.normal(1.5, 4, 80)
    ours = mean_difference(first, second)
    theirs = stats.bootstrap((second - first,), np.mean, method="percentile", rng=1).confidence_interval
    assert ours is not None
    assert (ours.low, ours.high) == pytest.approx(tuple(theirs), abs=0.06)


def test_a_constant_change_is_certain_and_one_episode_says_nothing() -> None:
    same = np.arange(10.0)
    difference = mean_difference(same, same + 2)
    assert difference == paired.Difference(2.0, 2.0, 2.0, 10)
    assert difference.is_clear
    assert mean_difference(same[:1], same[:1]) is None
