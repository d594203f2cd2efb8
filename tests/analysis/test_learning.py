"""Smoothing and selection of training episodes."""

from __future__ import annotations

import pandas as pd
import pytest

from dockctl.analysis.learning import from_initial_poses, moving_average, smoothing_window


@pytest.mark.parametrize(("count", "window"), [(3, 10), (800, 20), (100_000, 100)])
def test_smoothing_window(count: int, window: int) -> None:
    assert smoothing_window(pd.DataFrame(index=range(count))) == window


def test_moving_average_starts_with_fewer_values() -> None:
    assert moving_average(pd.Series([2.0, 4.0, 6.0, 9.0]), 3).tolist() == pytest.approx([2, 3, 4, 19 / 3])


def test_exploring_starts_are_left_out_unless_there_are_no_others() -> None:
    mixed = pd.DataFrame({"start_kind": ["pose", "exploring", "random"]})
    assert from_initial_poses(mixed)["start_kind"].tolist() == ["pose", "random"]
    exploring = mixed[mixed["start_kind"] == "exploring"]
    assert from_initial_poses(exploring).equals(exploring)
