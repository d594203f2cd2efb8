"""Summary of greedy episodes; smoothing and selection of training episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

AVERAGED = ("steps", "distance_m", "heading_error_deg", "speed_mps", "path_length_m", "control_changes")


def ending(row: Mapping[Any, Any]) -> str:
    """How an episode ended, in words.

    Args:
        row: columns ``outcome``, ``collided_with`` and ``phase`` of `dockctl.runs.tables.EPISODE_RESULT`.
    """
    if row["outcome"] == "collision":
        return f"collision with {row['collided_with'] or 'the harbor'}"
    if row["outcome"] == "timeout" and int(row["phase"]) == 0:
        return "timeout before the intermediate pose"
    return str(row["outcome"])


def kinds_of_ending(endings: Mapping[str, int]) -> dict[str, int]:
    """Return the counts of `endings`, with one count for collisions, whatever was hit."""
    kinds: Counter[str] = Counter()
    for words, count in endings.items():
        kinds[words.partition(" with ")[0]] += count
    return dict(kinds.most_common())


def summarize(rows: Sequence[Mapping[str, Any]], control_period_s: float) -> dict[str, Any]:
    """Success with its Wilson interval, endings, smallest clearance, and means over the docked episodes.

    Heading errors are averaged by magnitude.

    Args:
        rows: columns `dockctl.runs.tables.EPISODE_RESULT`, one row per episode.
        control_period_s: duration of a step [s].
    """
    from dockctl.analysis.statistics import wilson_interval  # loads scipy.stats, about a second

    docked = [row for row in rows if row["outcome"] == "docked"]
    low, high = wilson_interval(len(docked), len(rows))
    means = {
        name: sum(abs(float(row[name] or 0)) for row in docked) / len(docked) for name in AVERAGED if docked
    }
    clearances = [row["clearance_m"] for row in rows if row["clearance_m"] is not None]
    return {
        "episodes": len(rows),
        "docked": len(docked),
        "success": len(docked) / len(rows) if rows else None,
        "success_interval_95": [low, high],
        "endings": dict(Counter(map(ending, rows)).most_common()),
        "least_clearance_m": min(clearances, default=None),
        "mean_of_docked": {**means, "time_s": means["steps"] * control_period_s} if means else None,
    }


def smoothing_window(table: pd.DataFrame) -> int:
    """Number of rows to average over: about a fortieth of the table, 10 to 100."""
    return min(max(len(table) // 40, 10), 100)


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
