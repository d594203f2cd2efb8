"""Statistics of decision times against numpy."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dockctl.analysis.latency import PARTS, summarize, verdict


def test_summary() -> None:
    samples = pd.DataFrame({part: np.arange(1.0, 101.0) * (i + 1) for i, part in enumerate(PARTS)})
    for part, row in summarize(samples).items():
        values = samples[part].to_numpy()
        assert row == pytest.approx(
            {
                "mean": values.mean(),
                "p50": np.median(values),
                "p95": np.percentile(values, 95),
                "p99": np.percentile(values, 99),
                "max": values.max(),
            }
        )


def test_the_verdict_compares_with_the_control_period() -> None:
    row = {"p50": 0.5, "max": 50.0}
    text = verdict(dict.fromkeys(PARTS, row), 500.0)
    assert "10.0%" in text and "500 ms" in text
