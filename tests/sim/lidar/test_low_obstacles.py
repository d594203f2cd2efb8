"""The figure of docs/model.md: what the thesis' LiDARs measure of low obstacles alongside."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from dockctl.reports.style import figure_style
from tools.low_obstacles import draw, readings, steepest_deg

GAPS = np.arange(0.0, 2.01, 0.1)


@pytest.mark.parametrize(
    ("height_m", "least_m", "up_to_m"), [(0.5, 1.67, 1.1), (1.0, 1.43, 0.9), (2.0, 0.97, 0.4)]
)
def test_the_range_abeam_is_constant_up_to_a_gap_and_then_the_distance(
    height_m: float, least_m: float, up_to_m: float
) -> None:
    """The LiDAR is 0.5 m from the axis and 3 m high; its lowest laser points 50 + 15 degrees down."""
    ranges = readings(height_m, GAPS)
    near = np.arange(len(GAPS)) <= round(up_to_m / 0.1)
    assert 0.5 + (3 - height_m) / math.tan(math.radians(65)) == pytest.approx(least_m, abs=0.005)
    assert ranges[near] == pytest.approx(least_m, abs=0.01)
    assert ranges[~near] == pytest.approx(0.5 + GAPS[~near], abs=0.01)


def test_the_documentation_has_these_numbers() -> None:
    page = (Path(__file__).parents[3] / "docs" / "model.md").read_text(encoding="utf-8")
    for number in ("1.43 m", "0.93 m", "1.67 m", "1.17 m"):
        assert number in page
    assert steepest_deg() == 65


def test_the_figure_is_drawn() -> None:
    with figure_style():
        section, curves = draw().axes
    assert any("1.43 m" in text.get_text() for text in section.texts)
    assert len(curves.lines) == 4
