"""Statistics of decision times."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd

PARTS = {
    "scan_ms": "LiDAR scan",
    "state_ms": "State",
    "forward_ms": "Forward pass",
    "control_ms": "Supervisor, planner",
    "decision_ms": "Whole decision",
}
"""Columns of ``latency.csv`` [ms], with their names."""
OPTIONAL = "control_ms"
"""Only for policies with a supervisor or planner."""
REQUIRED = tuple(part for part in PARTS if part != OPTIONAL)
STATISTICS = {"mean": "mean", "p50": "50%", "p95": "95%", "p99": "99%", "max": "max"}
"""Names of the statistics here and in pandas."""


def summarize(samples: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Return mean, 50th, 95th and 99th percentile and maximum of each part of a decision [ms].

    Args:
        samples: one row per decision, columns `PARTS`.

    Returns:
        The values of `STATISTICS` by part.
    """
    parts = timed_parts(samples)
    table = samples[parts].describe(percentiles=[0.5, 0.95, 0.99])
    return {part: {name: float(table[part][row]) for name, row in STATISTICS.items()} for part in parts}


def timed_parts(samples: pd.DataFrame) -> list[str]:
    """Return the columns of `PARTS` that the table has."""
    return [part for part in PARTS if part in samples]


def verdict(summary: Mapping[str, Mapping[str, float]], control_period_ms: float) -> str:
    """Compare the slowest decision with the control period, in one sentence."""
    decision = summary["decision_ms"]["max"]
    return (
        f"Slowest decision: {decision:.3g} ms, {decision / control_period_ms:.1%} of the control period"
        f" of {control_period_ms:g} ms."
    )
