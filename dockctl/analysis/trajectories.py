"""Recorded trajectories, split by start pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from dockctl.drawing import palette


@dataclass(frozen=True)
class Track:
    """One greedy episode: its start pose as text, its color in every figure, and its rows."""

    label: str
    color: str
    table: pd.DataFrame

    @property
    def docked(self) -> bool:
        return bool(self.table["outcome"].iloc[-1] == "docked")

    @property
    def switch(self) -> int | None:
        """First row after the intermediate pose; None if the phase never changes."""
        changes = np.flatnonzero(np.diff(self.table["phase"].to_numpy()))
        return int(changes[0]) + 1 if len(changes) else None


def tracks_of(trajectories: pd.DataFrame) -> list[Track]:
    """Split ``trajectories.csv`` by start pose; one track is blue, several have the colors of Table 4.3."""
    groups = [rows.reset_index(drop=True) for _, rows in trajectories.groupby("pose", sort=False)]
    colors = palette.SERIES if len(groups) > 1 else (palette.SINGLE,)
    return [
        Track(pose_label(*rows.loc[0, ["x_m", "y_m", "heading_deg"]]), colors[i % len(colors)], rows)
        for i, rows in enumerate(groups)
    ]


def pose_label(x_m: float, y_m: float, heading_deg: float) -> str:
    """Pose as text: ``(20, 2, 160°)``, at most two decimals, heading in 0 to 360, typographic minus signs."""
    rounded = (round(x_m, 2), round(y_m, 2), round(heading_deg, 2) % 360)
    x, y, heading = (f"{value + 0.0:g}".replace("-", "−") for value in rounded)
    return f"({x}, {y}, {heading}°)"
