"""Bars, totals and break-even of the figure of returns."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dockctl.reports.returns import returns_figure
from dockctl.reports.style import figure_style
from tests.reports.synthetic import returns


@pytest.mark.parametrize("intermediate", [True, False])
@pytest.mark.parametrize("units", [(20.0, 1.0), (1.0,)])
def test_one_bar_per_behavior_and_unit(intermediate: bool, units: tuple[float, ...]) -> None:
    rows = returns(intermediate=intermediate)
    table = pd.concat([rows.assign(distance_unit_m=unit) for unit in units], ignore_index=True)
    with figure_style():
        figure = returns_figure(table, "caption")
        figure.draw_without_rendering()
    assert len(figure.axes) == len(units) + intermediate
    bars = figure.axes[: len(units)]
    names = [label.get_text().splitlines()[0] for label in bars[0].get_yticklabels()]
    assert names == list(rows["behavior"])
    for ax in bars:
        (markers,) = [line for line in ax.lines if line.get_marker() == "D"]
        assert np.array_equal(markers.get_xdata(), rows["return"])
        widths = pd.Series([bar.get_width() for bar in ax.patches])
        rounded = pd.Series([round(bar.get_y() + bar.get_height() / 2) for bar in ax.patches])
        assert widths.groupby(rounded).sum().tolist() == pytest.approx(rows["return"].tolist())


def test_the_advantage_of_docking_is_zero_at_break_even() -> None:
    with figure_style():
        figure = returns_figure(returns(), "caption")
    line, scenario, even = figure.axes[-1].lines[:3]
    x, y = (np.asarray(values, float) for values in (line.get_xdata(), line.get_ydata()))
    assert np.interp(500, x, y) == pytest.approx(0)
    assert y[0] == pytest.approx(700 - 900)
    assert (scenario.get_xdata()[0], scenario.get_ydata()[0]) == pytest.approx((250, 0.4 * (250 - 500)))
    assert even.get_xdata()[0] == pytest.approx(500)
