"""Markdown: tables, pictures, and numbers in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

NOT_RUN = "not run"


def table(rows: Sequence[Mapping[str, str]]) -> str:
    """A table whose columns are the keys of its rows, in the order in which they come up."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    lines = [columns, ["---"] * len(columns), *([row.get(name, "") for name in columns] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def picture(name: str, text: str, depth: int = 1) -> str:
    """A picture of the figures' folder, seen from a page `depth` folders below ``docs``."""
    return f"![{text}]({'../' * depth}figures/results/{name}.png)"


def listed(words: Iterable[str]) -> str:
    """``a, b and c``."""
    *most, last = list(words)
    return f"{', '.join(most)} and {last}" if most else last


def steps(value: int | None) -> str:
    """Environment steps, in thousands."""
    return "never" if value is None else f"{value:,}"


def share(counts: tuple[int, int] | None) -> str:
    """``k of n``."""
    return NOT_RUN if counts is None else f"{counts[0]:,} of {counts[1]:,}"


def spread(values: Sequence[float], form: str = "{:.1f}", unit: str = "") -> str:
    """One value, or the smallest and the largest."""
    if not values:
        return NOT_RUN
    low, high = form.format(min(values)), form.format(max(values))
    return (low if low == high else f"{low} to {high}") + unit
