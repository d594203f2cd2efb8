"""Summary of greedy episodes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from dockctl.analysis.statistics import wilson_interval

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


def summarize(rows: Sequence[Mapping[str, Any]], control_period_s: float) -> dict[str, Any]:
    """Success with its Wilson interval, endings, smallest clearance, and means over the docked episodes.

    Heading errors are averaged by magnitude.

    Args:
        rows: columns `dockctl.runs.tables.EPISODE_RESULT`, one row per episode.
        control_period_s: duration of a step [s].
    """
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
