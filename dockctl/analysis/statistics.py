"""What few episodes say about many."""

from __future__ import annotations

import math

RECENT = 100
"""Training episodes that tell how a training stands: the last ones."""


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a success probability (Wilson 1927); (0, 1) without trials."""
    if trials == 0:
        return 0.0, 1.0
    z = 1.959964  # of 95 %
    p, spread = successes / trials, z * z / trials
    center = (p + spread / 2) / (1 + spread)
    half = z * math.sqrt(p * (1 - p) / trials + spread / (4 * trials)) / (1 + spread)
    return max(0.0, center - half), min(1.0, center + half)
