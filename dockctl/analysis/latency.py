"""Statistics of decision times."""

from __future__ import annotations

import pandas as pd

PARTS = {
    "scan_ms": "LiDAR scan",
    "state_ms": "State",
    "forward_ms": "Forward pass",
    "decision_ms": "Whole decision",
}
"""Columns of ``latency.csv`` [ms], with their names."""
STATISTICS = ("mean", "p50", "p95", "p99", "max")
THESIS_FORWARD_MS = 2.0
"""Forward pass of the thesis' network on an i5-8400 (section 4.3.3)."""


def summarize(samples: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Mean, 50th, 95th and 99th percentile and maximum of each part of a decision [ms].

    Args:
        samples: one row per decision, columns `PARTS`.

    Returns:
        by part, the value of each of `STATISTICS`.
    """
    quantiles = {"p50": 0.5, "p95": 0.95, "p99": 0.99}
    return {
        part: {
            "mean": float(samples[part].mean()),
            **{name: float(samples[part].quantile(share)) for name, share in quantiles.items()},
            "max": float(samples[part].max()),
        }
        for part in PARTS
    }
