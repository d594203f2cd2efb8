"""Intervals and tests against published numbers, definitions, and brute force over every possible table."""

from __future__ import annotations

import math
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from dockctl.analysis import statistics
from dockctl.analysis.statistics import mcnemar_p, mean_difference, success_difference, wilson_interval
from dockctl.geometry import Bools

counts = st.integers(0, 60)


def table(both: int, only_first: int, only_second: int, neither: int) -> tuple[Bools, Bools]:
    """Outcomes of both policies with these counts."""
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
def test_the_interval_contains_the_difference_and_is_antisymmetric(a: int, b: int, c: int, d: int) -> None:
    if a + b + c + d == 0:
        return
    first, second = table(a, b, c, d)
    there, back = success_difference(first, second), success_difference(second, first)
    assert -1 - 1e-12 <= there.low <= there.value <= there.high <= 1 + 1e-12
    assert (there.low, there.value, there.high) == pytest.approx((-back.high, -back.value, -back.low))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("chances", "most"),
    [
        pytest.param((0.7, 0.2, 0.05, 0.05), 0.97, marks=pytest.mark.thorough),
        pytest.param((0.4, 0.1, 0.3, 0.2), 0.97, marks=pytest.mark.thorough),
        ((0.9, 0.04, 0.04, 0.02), 1.0),
    ],
)
def test_coverage(chances: tuple[float, ...], most: float) -> None:
    """Summed over every table of 30 episodes with its probability; conservative for rare failures."""
    n, truth, covered = 30, chances[2] - chances[1], 0.0
    for a, b, c in product(range(n + 1), repeat=3):
        if a + b + c <= n and (weight := stats.multinomial.pmf([a, b, c, n - a - b - c], n, chances)) > 1e-7:
            interval = success_difference(*table(a, b, c, n - a - b - c))
            covered += weight * (interval.low <= truth <= interval.high)
    assert 0.94 <= covered <= most


@given(counts, counts)
def test_mcnemar_sums_the_binomial_tails(only_first: int, only_second: int) -> None:
    trials, fewer = only_first + only_second, min(only_first, only_second)
    tail = Fraction(sum(math.comb(trials, k) for k in range(fewer + 1)), 2**trials)
    assert mcnemar_p(*table(3, only_first, only_second, 2)) == pytest.approx(float(min(1, 2 * tail)))


def test_mcnemar_works_for_many_episodes() -> None:
    p = mcnemar_p(*table(0, 30_000, 31_000, 0))
    z = 999 / math.sqrt(61_000)  # with continuity correction
    assert p == pytest.approx(math.erfc(z / math.sqrt(2)), rel=1e-3)


@pytest.mark.parametrize(("successes", "trials"), [(0, 1), (1, 1), (95, 100), (0, 20), (7, 13), (500, 1000)])
def test_wilson_limits_solve_the_score_equation(successes: int, trials: int) -> None:
    """At each limit p, the observed share is 1.96 standard errors away; 0 and 1 are limits themselves."""
    share = successes / trials
    low, high = wilson_interval(successes, trials)
    assert 0 <= low <= share <= high <= 1
    for limit in {low, high} - {share}:
        assert abs(share - limit) / math.sqrt(limit * (1 - limit) / trials) == pytest.approx(1.959963985)


@given(counts, counts)
def test_wilson_interval_is_that_of_scipy(successes: int, failures: int) -> None:
    if trials := successes + failures:
        interval = stats.binomtest(successes, trials).proportion_ci(0.95, method="wilson")
        assert wilson_interval(successes, trials) == (interval.low, interval.high)


def test_wilson_interval_without_trials() -> None:
    assert wilson_interval(0, 0) == (0.0, 1.0)


def test_the_bootstrap_agrees_with_all_resamples(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(statistics, "RESAMPLES", 40_000)
    first, second = np.array([1.0, 2.0, 4.0, 8.0, 3.0]), np.array([2.0, 2.5, 3.0, 12.0, 5.0])
    change = second - first
    means = [np.mean(change[list(drawn)]) for drawn in product(range(5), repeat=5)]
    low, high = np.quantile(means, [0.025, 0.975])
    difference = mean_difference(first, second)
    assert difference is not None
    assert difference.value == pytest.approx(change.mean())
    assert (difference.low, difference.high) == pytest.approx((low, high), abs=0.05)


def test_the_bootstrap_draws_the_same_resamples_as_a_loop() -> None:
    """The archived results depend on them."""
    rng = np.random.default_rng(5)
    first = rng.gamma(2, 10, 80)
    second = first + rng.normal(1.5, 4, 80)
    change, draws = second - first, np.random.default_rng(0)
    means = [change[draws.integers(80, size=80)].mean() for _ in range(10_000)]
    difference = mean_difference(first, second)
    assert difference is not None
    assert (difference.low, difference.high) == pytest.approx(np.quantile(means, [0.025, 0.975]), abs=1e-12)


def test_constant_and_single_differences() -> None:
    same = np.arange(10.0)
    difference = mean_difference(same, same + 2)
    assert difference == statistics.Difference(2.0, 2.0, 2.0, 10)
    assert difference.is_clear
    assert mean_difference(same[:1], same[:1]) is None
