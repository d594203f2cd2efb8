"""Paired comparison of policies on the same episodes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dockctl.analysis.statistics import Difference, mcnemar_p, mean_difference, success_difference

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Measure:
    """A column to compare and how to print it: name, unit, factor to that unit, and decimals."""

    column: str
    name: str
    unit: str
    factor: float
    decimals: int

    def text(self, value: float, *, signed: bool = False) -> str:
        """Format a value given in the column's unit in the unit that is printed."""
        number = round(self.factor * value, self.decimals) + 0.0  # avoids -0
        return f"{number:{'+' if signed and number else ''}.{self.decimals}f}".replace("-", "−")

    def quantity(self, *values: float, signed: bool = False) -> str:
        """Format the value, or the two ends of an interval, with the unit; a degree sign has no space."""
        texts = " to ".join(self.text(value, signed=signed) for value in values)
        return f"{texts}{'' if self.unit == '°' else ' '}{self.unit}"


SUCCESS = Measure("docked", "success", "%", 100, 1)
MEASURES = (
    Measure("time_s", "time", "s", 1, 1),
    Measure("path_length_m", "path", "m", 1, 2),
    Measure("clearance_m", "minimum clearance", "m", 1, 2),
    Measure("control_changes", "control changes", "%", 100, 1),
    Measure("propeller_change_n", "propeller change per step", "N", 1, 2),
    Measure("rudder_change_deg", "rudder change per step", "°", 1, 2),
)
"""Compared over the episodes in which both policies dock."""


@dataclass(frozen=True)
class Compared:
    """Means of one measure for two policies over the same episodes, and their difference."""

    first: float
    second: float
    difference: Difference


@dataclass(frozen=True)
class Contrast:
    """Comparison of a policy with the first policy over one kind of start.

    Attributes:
        compared: by measure. Success rates are over all episodes; the other measures are over the episodes
            in which both policies dock, and are missing for fewer than two.
        only_first, only_second: number of episodes in which only that policy docks.
        p: p-value of the exact McNemar test.
    """

    first: str
    second: str
    kind: str
    compared: dict[Measure, Compared]
    only_first: int
    only_second: int
    p: float

    @property
    def success(self) -> Compared:
        """Success rates over all episodes."""
        return self.compared[SUCCESS]


def contrasts(table: pd.DataFrame) -> Iterator[Contrast]:
    """Compare every policy with the first policy, separately for each kind of start.

    Evaluation poses are excluded: they are not a random sample, so intervals and tests do not apply to them.

    Args:
        table: columns ``policy`` and `dockctl.runs.tables.EVALUATION`, the same starts for every policy.
    """
    first, *others = table["policy"].unique()
    for kind in table["start_kind"].unique():
        if kind == "pose":
            continue
        rows = {name: _episodes(table, name, kind) for name in (first, *others)}
        for other in others:
            yield _contrast(first, rows[first], other, rows[other], kind)


def _episodes(table: pd.DataFrame, policy: str, kind: str) -> pd.DataFrame:
    rows = table[(table["policy"] == policy) & (table["start_kind"] == kind)].set_index("start").sort_index()
    return rows.assign(docked=rows["outcome"] == "docked")


def _contrast(first: str, a: pd.DataFrame, second: str, b: pd.DataFrame, kind: str) -> Contrast:
    a_docks, b_docks = a["docked"].to_numpy(bool), b["docked"].to_numpy(bool)
    both = a_docks & b_docks
    rates = float(np.mean(a_docks)), float(np.mean(b_docks))
    compared = {SUCCESS: Compared(*rates, success_difference(a_docks, b_docks))}
    for measure in MEASURES:
        x, y = (rows[measure.column].to_numpy(float)[both] for rows in (a, b))
        if (difference := mean_difference(x, y)) is not None:
            compared[measure] = Compared(float(x.mean()), float(y.mean()), difference)
    return Contrast(
        first=first,
        second=second,
        kind=kind,
        compared=compared,
        only_first=int((a_docks & ~b_docks).sum()),
        only_second=int((~a_docks & b_docks).sum()),
        p=mcnemar_p(a_docks, b_docks),
    )
