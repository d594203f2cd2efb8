"""Smoothing and selection of training episodes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

RECENT = 100
"""Number of last training episodes that summarize how a training is doing."""


def smoothing_window(table: pd.DataFrame) -> int:
    """Number of rows to average over: about a fortieth of the table, 10 to 100."""
    return int(np.clip(len(table) // 40, 10, 100))


def moving_average(values: pd.Series, window: int) -> pd.Series:
    """Mean of each value and those before it, `window` in all; fewer at the beginning."""
    return values.rolling(window, min_periods=1).mean()


def from_initial_poses(episodes: pd.DataFrame) -> pd.DataFrame:
    """Leave out episodes with exploring starts, unless there are no others."""
    selected = episodes[episodes["start_kind"] != "exploring"]
    return selected if len(selected) else episodes


def term_columns(table: pd.DataFrame) -> list[str]:
    """Names of the columns that hold the sum of a reward term per episode."""
    return [str(column) for column in table if str(column).startswith("reward_")]
