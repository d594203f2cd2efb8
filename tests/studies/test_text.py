"""Interquartile means against brute force, intervals that repeat, and curves of different lengths."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from studies.thesis.text import interquartile_mean, interval, on_common_grid

numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=12)


@given(numbers)
def test_middle_half_by_brute_force(values: list[float]) -> None:
    quadrupled = np.sort(np.repeat(values, 4))  # four of each, so that the quarters are whole numbers
    quarter = len(values)
    expected = quadrupled[quarter:-quarter].mean()
    assert interquartile_mean(np.array(values)) == pytest.approx(expected, rel=1e-9, abs=1e-6)


def test_outlier_does_not_change_it() -> None:
    calm, wild = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.0, 2.0, 3.0, 4000.0])
    assert interquartile_mean(calm) == interquartile_mean(wild) == 2.5


@given(numbers)
def test_interval_repeats_and_contains_the_mean(values: list[float]) -> None:
    array = np.array(values)
    low, high = interval(array, resamples=200)
    assert (low, high) == interval(array, resamples=200)
    assert low - 1e-6 <= interquartile_mean(array) <= high + 1e-6 or len(values) < 4
    assert array.min() - 1e-6 <= low <= high <= array.max() + 1e-6


def test_curve_has_its_last_value_after_its_end() -> None:
    grid, values = on_common_grid([pd.Series([0.0, 1.0], [1, 10]), pd.Series([5.0, 5.0], [1, 40])])
    assert grid[-1] == 40
    assert values[-1].tolist() == [1.0, 5.0]
    assert values[grid > 10][0, 0] == 1.0
