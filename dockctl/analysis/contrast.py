"""What a table of the same episodes, sailed by several policies, says about their differences."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from dockctl.analysis.paired import Difference, mcnemar_p, mean_difference, success_difference


@dataclass(frozen=True)
class Measure:
    """A column to compare, and how to tell of it: name, unit, factor to that unit, and decimals."""

    column: str
    name: str
    unit: str
    factor: float
    decimals: int

    def text(self, value: float, *, signed: bool = False) -> str:
        """The value, given in the column's own unit, as a number in the unit that is shown."""
        number = round(self.factor * value, self.decimals) + 0.0  # no minus before a zero
        return f"{number:{'+' if signed and number else ''}.{self.decimals}f}".replace("-", "−")


SUCCESS = Measure("docked", "success", "%", 100, 1)
MEASURES = (
    Measure("time_s", "time", "s", 1, 1),
    Measure("path_length_m", "path", "m", 1, 2),
    Measure("clearance_m", "least clearance", "m", 1, 2),
    Measure("control_changes", "control changes", "%", 100, 1),
)
"""What is compared over the episodes that both policies dock."""


@dataclass(frozen=True)
class Compared:
    """One measure of two policies over the same episodes; the means of each, and the difference."""

    measure: Measure
    first: float
    second: float
    difference: Difference


@dataclass(frozen=True)
class Contrast:
    """How a policy differs from the first one over the episodes of one sort of starts.

    Attributes:
        success: of every episode.
        docked: the other measures, over the episodes that both dock; none for fewer than two of them.
        only_first, only_second: episodes that one docks and the other does not.
        p: probability of so uneven a split if neither were better (exact McNemar test).
    """

    first: str
    second: str
    kind: str
    success: Compared
    docked: tuple[Compared, ...]
    only_first: int
    only_second: int
    p: float


def contrasts(table: pd.DataFrame) -> Iterator[Contrast]:
    """Compare every policy with the first one, one sort of starts after the other.

    Test poses are left out: they are chosen, not drawn, so that nothing follows from them for other starts.

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
    compared = []
    for measure in MEASURES:
        x, y = (rows[measure.column].to_numpy(float)[both] for rows in (a, b))
        if (difference := mean_difference(x, y)) is not None:
            compared.append(Compared(measure, float(x.mean()), float(y.mean()), difference))
    rates = float(np.mean(a_docks)), float(np.mean(b_docks))
    return Contrast(
        first=first,
        second=second,
        kind=kind,
        success=Compared(SUCCESS, *rates, success_difference(a_docks, b_docks)),
        docked=tuple(compared),
        only_first=int((a_docks & ~b_docks).sum()),
        only_second=int((~a_docks & b_docks).sum()),
        p=mcnemar_p(a_docks, b_docks),
    )
