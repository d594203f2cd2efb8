"""Confidence intervals and tests for success rates and for paired differences."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dockctl.geometry import Bools, Floats

RESAMPLES = 10_000
BATCH = 100
"""Resamples drawn at a time, to bound the memory for many episodes."""


@dataclass(frozen=True)
class Difference:
    """Second minus first over `pairs` paired episodes, with its 95 % confidence limits."""

    value: float
    low: float
    high: float
    pairs: int

    @property
    def is_clear(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of a success probability (Wilson 1927); (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    from scipy.stats import binomtest  # slow to import

    interval = binomtest(successes, trials).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def describe_share(successes: int, trials: int) -> tuple[str, str, str]:
    """Return ``k of n``, the success rate and its 95 % interval, as text; `trials` is at least 1."""
    low, high = wilson_interval(successes, trials)
    return f"{successes:,} of {trials:,}", f"{successes / trials:.1%}", f"{low:.1%} to {high:.1%}"


def success_difference(first: Bools, second: Bools) -> Difference:
    """Return the difference of two success rates over the same episodes, by Newcombe's method 10.

    It combines the two Wilson intervals and accounts for their correlation (Newcombe 1998, Stat. Med. 17,
    2635-2650). Unlike a bootstrap interval, it has nonzero width even if the outcomes never differ.

    Args:
        first, second: (k,) whether each policy docked in episode i; k >= 1.
    """
    n = len(first)
    both, neither = int((first & second).sum()), int((~first & ~second).sum())
    only_first, only_second = int((first & ~second).sum()), int((~first & second).sum())
    p, q = second.mean(), first.mean()
    p_low, p_high = wilson_interval(int(second.sum()), n)
    q_low, q_high = wilson_interval(int(first.sum()), n)
    phi = _phi(both, only_first, only_second, neither)

    def width(of_p: float, of_q: float) -> float:
        return math.sqrt(max(0.0, of_p**2 - 2 * phi * of_p * of_q + of_q**2))

    low, high = width(p - p_low, q_high - q), width(p_high - p, q - q_low)
    return Difference(float(p - q), float(p - q) - low, float(p - q) + high, n)


def _phi(both: int, only_first: int, only_second: int, neither: int) -> float:
    """Return the phi coefficient of a 2x2 table with Newcombe's continuity correction; 0 if undefined."""
    margins = (both + only_first) * (only_second + neither) * (both + only_second) * (only_first + neither)
    if margins == 0:
        return 0.0
    n = both + only_first + only_second + neither
    determinant = both * neither - only_first * only_second
    corrected = determinant if determinant < 0 else max(0.0, determinant - n / 2)
    return corrected / math.sqrt(margins)


def mcnemar_p(first: Bools, second: Bools) -> float:
    """Return the p-value of the exact two-sided McNemar test; H0: neither policy docks more often.

    Args:
        first, second: (k,) whether each policy docked in episode i.
    """
    only_first, only_second = int((first & ~second).sum()), int((~first & second).sum())
    discordant = only_first + only_second
    from scipy.stats import binomtest

    return float(binomtest(only_first, discordant, 0.5).pvalue) if discordant else 1.0


def mean_difference(first: Floats, second: Floats) -> Difference | None:
    """Return the difference of the means of a measure over the same episodes, by percentile bootstrap.

    Args:
        first, second: (k,) the measure of each policy in episode i.

    Returns:
        None for fewer than two episodes.
    """
    change = np.asarray(second, float) - np.asarray(first, float)
    if len(change) < 2:
        return None
    from scipy.stats import bootstrap

    result = bootstrap(
        (change,),
        np.mean,
        n_resamples=RESAMPLES,
        batch=BATCH,
        confidence_level=0.95,
        method="percentile",
        rng=np.random.default_rng(0),
    )
    low, high = result.confidence_interval
    return Difference(float(change.mean()), float(low), float(high), len(change))
