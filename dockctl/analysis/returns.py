"""Comparison of the discounted returns of behaviors: which one a reward favors (``dockctl returns``)."""

from __future__ import annotations

from collections.abc import Iterator

import pandas as pd

DOCKING, FAILING, AT_START = "dock", "fail to dock", "loiter at the start"
BEFORE_INTERMEDIATE = "loiter before the intermediate pose"
INTERMEDIATE = "reward_intermediate"


def format_unit(unit_m: float) -> str:
    """Return the distance unit as text."""
    return "meters" if unit_m == 1 else f"units of {unit_m:g} m"


def value(rows: pd.DataFrame, behavior: str, column: str) -> float:
    """Return the value of a column for one behavior."""
    return float(rows[rows["behavior"] == behavior][column].iloc[0])


def break_even(rows: pd.DataFrame) -> float | None:
    """Return the reward of the intermediate pose above which docking returns more than loitering before it.

    Args:
        rows: the behaviors with one distance unit, columns `dockctl.runs.tables.RETURNS`.

    Returns:
        None if the task has no intermediate pose or no reward for it, or the policy does not dock.
    """
    if not {DOCKING, BEFORE_INTERMEDIATE} <= {*rows["behavior"]} or INTERMEDIATE not in rows:
        return None
    deficit = value(rows, BEFORE_INTERMEDIATE, "return") - value(rows, DOCKING, "return")
    return (value(rows, DOCKING, INTERMEDIATE) + deficit) / value(rows, DOCKING, "intermediate_discount")


def verdicts(rows: pd.DataFrame) -> Iterator[str]:
    """Yield sentences that state which behavior the reward favors with one distance unit."""
    collisions = rows[rows["outcome"] == "collision"]
    docks = DOCKING in set(rows["behavior"])
    greedy, waiting = (value(rows, name, "return") for name in (DOCKING if docks else FAILING, AT_START))
    name = "Docking" if docks else "The policy does not dock: its episode"
    returns = [f"{name} returns {greedy:,.0f}", f"waiting at the start {waiting:,.0f}"]
    if len(collisions):
        best = collisions.sort_values("return").iloc[-1]
        returns.insert(1, f"the best collision ({best['behavior']}) {best['return']:,.0f}")
    yield f"{', '.join(returns)}."
    if (least := break_even(rows)) is not None:
        exceeds = f"if the reward of that pose exceeds {least:,.0f}"
        condition = exceeds if least > 0 else "for any reward of that pose"
        yield (
            "Loitering just before the intermediate pose returns"
            f" {value(rows, BEFORE_INTERMEDIATE, 'return'):,.0f}: docking returns more {condition}."
        )
