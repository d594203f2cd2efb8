"""Interquartile means over seeds, with bootstrap intervals that repeat."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RESAMPLES = 2000
POINTS = 240


def interquartile_mean(values: Floats) -> Floats:
    """Mean of the middle half along the last axis; values at its edges count in part."""
    n = values.shape[-1]
    edges = np.clip(np.arange(n + 1) / n, 0.25, 0.75)
    return np.asarray(np.sort(values, axis=-1) @ (2 * np.diff(edges)))


def interval(values: Floats, resamples: int = RESAMPLES) -> tuple[Floats, Floats]:
    """95 % percentile bootstrap interval of the interquartile mean along the last axis, (..., seeds)."""
    seeds = values.shape[-1]
    draws = np.random.default_rng(0).integers(seeds, size=(resamples, seeds))
    means = interquartile_mean(values[..., draws])
    low, high = np.quantile(means, [0.025, 0.975], axis=-1)
    return low, high


def on_a_grid(curves: Sequence[pd.Series]) -> tuple[Floats, Floats]:
    """Curves over different ranges on one grid; a curve keeps its last value after its end.

    Returns:
        the grid (k,) and the values (k, curves).
    """
    longest = max(float(curve.index[-1]) for curve in curves)
    grid = np.linspace(0, longest, POINTS)
    return grid, np.column_stack([np.interp(grid, curve.index.to_numpy(float), curve) for curve in curves])
