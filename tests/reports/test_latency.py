"""Histograms of decision times."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dockctl.analysis.latency import PARTS
from dockctl.reports.latency import latency_figure
from dockctl.reports.style import figure_style


@pytest.fixture
def samples() -> pd.DataFrame:
    return pd.DataFrame({part: np.arange(1.0, 101.0) * (i + 1) for i, part in enumerate(PARTS)})


def test_every_decision_is_counted_and_the_control_period_is_marked(samples: pd.DataFrame) -> None:
    with figure_style():
        figure = latency_figure(samples, "test", 500.0)
    assert len(figure.axes) == len(PARTS)
    for ax in figure.axes:
        assert sum(bar.get_height() for bar in ax.patches) == len(samples)
    assert [list(line.get_xdata()) for line in figure.axes[2].lines] == [[500.0, 500.0]]
    texts = {text.get_text() for ax in figure.axes for text in ax.texts}
    assert texts == {"control period 500 ms"}
    assert "[ms]" in figure.axes[-1].get_xlabel()
