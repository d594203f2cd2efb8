"""Success over start poses around a reference pose (the table of ``dockctl map``).

Only free starts count: those with the hull in the water and clear of obstacles. The others are blocked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dockctl.runs.tables import MAP_START

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = (*MAP_START, "outcome")
"""Columns of ``map.csv`` that these functions and the figure need."""
SMALL_OFFSET_DEG = 20.0
"""Maximum heading offset to expect when a person steers the boat to the start pose."""
EPS = 1e-6


def free_starts(table: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with an episode; add `offset_m`, the distance from the reference pose, and `docked`."""
    free = table[table["blocked"] == 0]
    return free.assign(
        offset_m=np.hypot(free["dx_m"], free["dy_m"]).round(9), docked=free["outcome"] == "docked"
    )


def within_heading(free: pd.DataFrame, limit_deg: float) -> pd.DataFrame:
    """Return the starts whose heading offset is at most `limit_deg` in magnitude."""
    return free[free["dheading_deg"].abs() <= limit_deg + EPS]


def within_distance(free: pd.DataFrame, limit_m: float) -> pd.DataFrame:
    """Return the starts at most `limit_m` from the reference pose."""
    return free[free["offset_m"] <= limit_m + EPS]


def half_width(table: pd.DataFrame) -> float:
    """Return the half-width of the square start grid [m]."""
    return float(max(table["dx_m"].max(), table["dy_m"].max()))


def success_radius(free: pd.DataFrame, limit_m: float) -> float | None:
    """Return the largest grid distance within which every free start docks [m], at most `limit_m`.

    Returns:
        None if the start at the reference pose fails or is blocked.
    """
    distances = np.sort(free["offset_m"].unique())
    failing = free.loc[~free["docked"], "offset_m"].min()  # NaN if none fails
    inside = distances[~(distances >= failing) & (distances <= limit_m + EPS)]
    return float(inside[-1]) if len(inside) and inside[0] == 0 else None


def format_radius(radius_m: float | None) -> str:
    """Return a success radius as text."""
    return "none" if radius_m is None else f"{radius_m:.3g} m"
