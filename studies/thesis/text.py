"""Numbers as text, and Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from dockctl.geometry import Floats

RESAMPLES = 2000
POINTS = 240


def table(rows: Iterable[Mapping[str, str]]) -> str:
    """Markdown table; its columns are the keys of the rows in the order of their first use."""
    rows = list(rows)
    columns = list(dict.fromkeys(name for row in rows for name in row))
    lines = [columns, ["---"] * len(columns), *([row.get(name, "") for name in columns] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def listed(words: Iterable[str]) -> str:
    """``a, b and c``."""
    *most, last = list(words)
    return f"{', '.join(most)} and {last}" if most else last


def steps(value: int | None) -> str:
    return "never" if value is None else f"{value:,}"


def share(count: int, total: int) -> str:
    return f"{count:,} of {total:,}"


def spread(values: Sequence[float], form: str = "{:.1f}", unit: str = "") -> str:
    """Smallest and largest value, or one where they print the same; ``none`` without values."""
    if not values:
        return "none"
    low, high = form.format(min(values)), form.format(max(values))
    return (low if low == high else f"{low} to {high}") + unit


def middle(values: Sequence[float], form: str = "{:,.0f}") -> str:
    """Interquartile mean and its 95 % bootstrap interval."""
    array = np.array(values, float)
    low, high = interval(array)
    return f"{form.format(interquartile_mean(array))} [{form.format(low)}, {form.format(high)}]"


def docked_share(counts: Mapping[str, int] | None) -> str:
    """Docked episodes of all."""
    return share(counts["docked"], sum(counts.values())) if counts else "none"


def outcome_counts(counts: Mapping[str, int] | None) -> str:
    """``docked / collision / timeout``."""
    return " / ".join(f"{count:,}" for count in counts.values()) if counts else "none"


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


def on_common_grid(curves: Sequence[pd.Series]) -> tuple[Floats, Floats]:
    """Interpolate curves of different lengths; after its end a curve has its last value.

    Returns:
        the grid (k,) and the values (k, curves).
    """
    longest = max(float(curve.index[-1]) for curve in curves)
    grid = np.linspace(0, longest, POINTS)
    return grid, np.column_stack([np.interp(grid, curve.index.to_numpy(float), curve) for curve in curves])
