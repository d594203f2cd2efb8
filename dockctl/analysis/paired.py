"""Two policies on the same episodes: how far they differ, and how sure that is."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dockctl.analysis.statistics import wilson_interval

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RESAMPLES = 10_000


@dataclass(frozen=True)
class Difference:
    """The second less the first over `pairs` episodes, with the limits of its 95 % confidence interval."""

    value: float
    low: float
    high: float
    pairs: int

    @property
    def is_clear(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.low > 0 or self.high < 0


def success_difference(first: Bools, second: Bools) -> Difference:
    """Difference of two success rates over the same episodes (k,), by Newcombe's method 10.

    It joins the Wilson intervals of the two rates with regard to their correlation (Newcombe 1998, Stat. Med.
    17, 2635-2650). It is wider than nothing where the two never differ, as a bootstrap's would not be.
    """
    n = len(first)
    both, neither = int((first & second).sum()), int((~first & ~second).sum())
    only_first, only_second = int((first & ~second).sum()), int((~first & second).sum())
    p, q = second.mean(), first.mean()
    p_low, p_high = wilson_interval(int(second.sum()), n)
    q_low, q_high = wilson_interval(int(first.sum()), n)
    phi = _correlation(both, only_first, only_second, neither)

    def reach(of_p: float, of_q: float) -> float:
        return math.sqrt(max(0.0, of_p**2 - 2 * phi * of_p * of_q + of_q**2))

    low, high = reach(p - p_low, q_high - q), reach(p_high - p, q - q_low)
    return Difference(float(p - q), float(p - q) - low, float(p - q) + high, n)


def _correlation(both: int, only_first: int, only_second: int, neither: int) -> float:
    """Phi of a fourfold table, drawn to zero by half an episode where it is positive; 0 where undefined."""
    margins = (both + only_first) * (only_second + neither) * (both + only_second) * (only_first + neither)
    if margins == 0:
        return 0.0
    n = both + only_first + only_second + neither
    excess = both * neither - only_first * only_second
    return (excess if excess < 0 else max(0.0, excess - n / 2)) / math.sqrt(margins)


def mcnemar_p(first: Bools, second: Bools) -> float:
    """Probability, if neither is better, of so uneven a split of the episodes in which only one succeeds.

    The exact two-sided McNemar test.
    """
    only_first, only_second = int((first & ~second).sum()), int((~first & second).sum())
    n, fewer = only_first + only_second, min(only_first, only_second)
    all_splits = math.lgamma(n + 1) - n * math.log(2)
    tail = sum(math.exp(all_splits - math.lgamma(k + 1) - math.lgamma(n - k + 1)) for k in range(fewer + 1))
    return min(1.0, 2 * tail)


def mean_difference(first: Floats, second: Floats, *, seed: int = 0) -> Difference | None:
    """Difference of the means of two measures over the same episodes (k,), by the percentile bootstrap.

    Returns:
        None for fewer than two episodes.
    """
    change = np.asarray(second, float) - np.asarray(first, float)
    if len(change) < 2:
        return None
    rng, n = np.random.default_rng(seed), len(change)
    means = [change[rng.integers(n, size=n)].mean() for _ in range(RESAMPLES)]
    low, high = np.quantile(means, [0.025, 0.975])
    return Difference(float(change.mean()), float(low), float(high), n)
