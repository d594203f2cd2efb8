"""Summary of greedy episodes; smoothing and selection of training episodes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dockctl.analysis.statistics import wilson_interval
from dockctl.runs.tables import EXPLORING, RETRIED

if TYPE_CHECKING:
    import pandas as pd

AVERAGED = (
    "steps", "distance_m", "heading_error_deg", "speed_mps", "path_length_m", "control_changes",
    "propeller_change_n", "rudder_change_deg",
)  # fmt: skip
CLEARANCES_M = (0.1, 0.3, 0.5)
"""Minimum clearances for which success is reported."""


def describe_outcome(row: Mapping[Any, Any]) -> str:
    """Return the outcome of an episode as text, with what was hit and whether a timeout was early.

    Args:
        row: columns ``outcome``, ``collided_with`` and ``phase`` of `dockctl.runs.tables.EPISODE_RESULT`.
    """
    if row["outcome"] == "collision":
        return f"collision with {row['collided_with'] or 'the harbor'}"
    if row["outcome"] == "timeout" and int(row["phase"]) == 0:
        return "timeout before the intermediate pose"
    return str(row["outcome"])


def count_by_kind(outcomes: Mapping[str, int]) -> dict[str, int]:
    """Return the counts of described outcomes, with one count for all collisions."""
    kinds: Counter[str] = Counter()
    for text, count in outcomes.items():
        kinds[text.partition(" with ")[0]] += count
    return dict(kinds.most_common())


def docks_with_clearance(row: Mapping[str, Any], least_m: float) -> bool:
    """Return whether an episode docked and its clearance was measured and never below `least_m`."""
    clearance = row["clearance_m"]
    return row["outcome"] == "docked" and _is_given(clearance) and float(clearance) >= least_m


def _is_given(value: Any) -> bool:
    """Return whether a cell of a table has a value; an empty cell is None or, in data frames, NaN."""
    return value is not None and not math.isnan(value)


def summarize(rows: Sequence[Mapping[str, Any]], control_period_s: float) -> dict[str, Any]:
    """Summarize success with its Wilson interval, outcomes, clearance, contact speeds, and means if docked.

    Success at a clearance of x m counts the episodes that dock and come no closer than x m to anything.
    Heading errors are averaged by magnitude.

    Args:
        rows: columns `dockctl.runs.tables.EPISODE_RESULT` and, except in tables of earlier versions,
            `dockctl.runs.tables.MANEUVER`; one row per episode.
        control_period_s: duration of a step [s].
    """
    docked = [row for row in rows if row["outcome"] == "docked"]
    means = {
        name: sum(abs(float(row[name] or 0)) for row in docked) / len(docked)
        for name in AVERAGED
        if docked and name in docked[0]
    }
    clearances = [row["clearance_m"] for row in rows if _is_given(row["clearance_m"])]
    contacts = [row["contact_speed_mps"] for row in rows if _is_given(row.get("contact_speed_mps"))]

    def success(count: int) -> dict[str, Any]:
        return {
            "docked": count,
            "success": count / len(rows) if rows else None,
            "success_interval_95": list(wilson_interval(count, len(rows))),
        }

    at_clearance = {
        f"{least:g}": success(sum(docks_with_clearance(row, least) for row in rows)) for least in CLEARANCES_M
    }
    return {
        "episodes": len(rows),
        **success(len(docked)),
        "success_at_clearance_m": at_clearance if clearances else None,
        "endings": dict(Counter(map(describe_outcome, rows)).most_common()),
        "least_clearance_m": min(clearances, default=None),
        "contact_speed_mps": {"mean": sum(contacts) / len(contacts), "max": max(contacts)}
        if contacts
        else None,
        "mean_of_docked": {**means, "time_s": means["steps"] * control_period_s} if means else None,
    }


def smoothing_window(table: pd.DataFrame) -> int:
    """Return the number of rows to average over: about a fortieth of the table, 10 to 100."""
    return min(max(len(table) // 40, 10), 100)


def moving_average(values: pd.Series, window: int) -> pd.Series:
    """Return the mean of each value and the values before it, `window` in total; fewer at the beginning."""
    return values.rolling(window, min_periods=1).mean()


def from_initial_poses(episodes: pd.DataFrame) -> pd.DataFrame:
    """Return the episodes without those from exploring and retried starts, unless there are no others."""
    selected = by_start(episodes)[0]
    return selected if len(selected) else episodes


def by_start(episodes: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame, str]:
    """Return the episodes from initial poses, the others, and what the starts of the others are."""
    others = episodes["start_kind"].isin((EXPLORING, RETRIED))
    kinds = sorted(episodes.loc[others, "start_kind"].unique())
    return episodes[~others], episodes[others], " or ".join(kinds)


def term_columns(table: pd.DataFrame) -> list[str]:
    """Return the names of the columns with the sum of a reward term per episode."""
    return [str(column) for column in table if str(column).startswith("reward_")]
