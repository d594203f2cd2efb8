"""Break-even rewards and verdicts, by hand."""

from __future__ import annotations

import re

import pytest

from dockctl.analysis.returns import BEFORE_INTERMEDIATE, break_even, format_unit, verdicts
from tests.reports.synthetic import returns


def numbers(sentence: str) -> list[str]:
    return re.findall(r"-?\d+(?:,\d{3})*", sentence)


def test_break_even_reward_of_the_intermediate_pose() -> None:
    assert break_even(returns()) == pytest.approx((900 - 700) / 0.4)
    assert break_even(returns(intermediate=False)) is None


def test_numbers_in_the_verdicts() -> None:
    first, second = verdicts(returns())
    assert numbers(first) == ["-800", "-850", "-2,000"]  # docking, best collision, waiting
    assert "full astern" in first
    assert numbers(second) == ["-700", "500"]
    (alone,) = verdicts(returns(intermediate=False).query("outcome != 'collision'"))
    assert numbers(alone) == ["-900", "-2,000"]


def test_docking_can_return_more_without_any_reward_of_the_intermediate_pose() -> None:
    table = returns()
    table.loc[table["behavior"] == BEFORE_INTERMEDIATE, "return"] = -1000.0  # docking costs 900
    *_, verdict = verdicts(table)
    assert numbers(verdict) == ["-1,000"]


def test_format_unit() -> None:
    assert format_unit(1.0) == "meters"
    assert format_unit(0.5) == "units of 0.5 m"
