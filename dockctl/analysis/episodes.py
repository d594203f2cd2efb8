"""What a set of episodes says about a policy."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any

from dockctl.analysis.statistics import wilson_interval
from dockctl.evaluation.rollout import Episode

AVERAGED = ("steps", "distance_m", "heading_error_deg", "speed_mps", "path_length_m", "control_changes")


def ending(episode: Episode) -> str:
    """How an episode ended, in words: docked, collision with what, or timeout in which phase."""
    if episode.outcome == "collision":
        return f"collision with {episode.collided_with or 'the harbor'}"
    if episode.outcome == "timeout":
        return f"timeout in phase {episode.phase}"
    return episode.outcome


def summarize(episodes: Sequence[Episode], control_period_s: float) -> dict[str, Any]:
    """Success with its Wilson interval, endings by kind, least clearance, and means over the docked episodes.

    Heading errors count by their size.
    """
    docked = [episode for episode in episodes if episode.docked]
    low, high = wilson_interval(len(docked), len(episodes))
    rows = [episode.row() for episode in docked]
    means = {name: sum(abs(float(row[name] or 0)) for row in rows) / len(rows) for name in AVERAGED if rows}
    clearances = [e.clearance_m for e in episodes if not math.isnan(e.clearance_m)]
    return {
        "episodes": len(episodes),
        "docked": len(docked),
        "success": len(docked) / len(episodes) if episodes else None,
        "success_interval_95": [low, high],
        "endings": dict(Counter(map(ending, episodes)).most_common()),
        "least_clearance_m": min(clearances, default=None),
        "mean_of_docked": {**means, "time_s": means["steps"] * control_period_s} if means else None,
    }
