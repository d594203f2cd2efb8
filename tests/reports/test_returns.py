"""The returns of behaviors: what follows from them, and what is drawn."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from dockctl.analysis.returns import AT_GATE, AT_START, DOCKING, break_even, unit_words, verdicts
from dockctl.reports.returns import returns_figure
from dockctl.reports.style import house_style, save

BEHAVIORS = {DOCKING: "docked", AT_START: "timeout", AT_GATE: "timeout", "full astern": "collision"}


def returns(unit_m: float = 1.0, *, gate: bool = True) -> pd.DataFrame:
    """Docking costs 900, and 0.4 of what the gate pays comes back; loitering at the gate costs 700."""
    rows = {
        DOCKING: {"reward_distance": -900.0, "reward_mine": 0.0, "reward_intermediate": 0.4 * 250},
        AT_START: {"reward_distance": -1900.0, "reward_mine": -100.0},
        AT_GATE: {"reward_distance": -700.0},
        "full astern": {"reward_distance": -800.0, "reward_mine": -50.0},
    }
    table = pd.DataFrame(
        {
            "behavior": name,
            "outcome": BEHAVIORS[name],
            "steps": 100,
            "time_s": 50.0,
            "distance_unit_m": unit_m,
            "gate_discount": 0.4 if name == DOCKING else 0.0,
            **terms,
        }
        for name, terms in rows.items()
        if gate or name != AT_GATE
    ).fillna(0.0)
    if not gate:
        table = table.drop(columns="reward_intermediate")
    return table.assign(**{"return": table.filter(like="reward_").sum(axis=1)})


def test_the_break_even_reward_of_the_gate() -> None:
    assert break_even(returns()) == pytest.approx((900 - 700) / 0.4)
    assert break_even(returns(gate=False)) is None


def test_what_follows_is_said_in_numbers() -> None:
    first, second = verdicts(returns())
    assert first == (
        "Docking is worth -800, the best way to hit something (full astern) -850,"
        " waiting at the start -2,000."
    )
    assert "Loitering at the gate, just before the intermediate pose, is worth -700" in second
    assert second.endswith("if that pose pays more than 500.")
    (alone,) = verdicts(returns(gate=False).query("outcome != 'collision'"))
    assert alone == "Docking is worth -900, waiting at the start -2,000."


def test_docking_can_be_worth_more_whatever_the_gate_pays() -> None:
    table = returns()
    table.loc[table["behavior"] == AT_GATE, "return"] = -1000.0  # less than the 900 that docking costs
    *_, verdict = verdicts(table)
    assert verdict.endswith("docking is worth more whatever that pose pays.")


def test_units_in_words() -> None:
    assert (unit_words(1.0), unit_words(20.0), unit_words(0.5)) == (
        "meters",
        "units of 20 m",
        "units of 0.5 m",
    )


@pytest.mark.parametrize("gate", [True, False])
@pytest.mark.parametrize("units", [(20.0, 1.0), (1.0,)])
def test_a_bar_for_each_behavior_under_each_reading(
    gate: bool, units: tuple[float, ...], tmp_path: Path
) -> None:
    table = pd.concat([returns(unit, gate=gate) for unit in units], ignore_index=True)
    with house_style():
        figure = returns_figure(table, "made up")
        assert all(path.stat().st_size > 10_000 for path in save({"returns": figure}, tmp_path))
    bars = figure.axes[: len(units)]
    assert len(figure.axes) == len(units) + gate
    names = [label.get_text().splitlines()[0] for label in bars[0].get_yticklabels()]
    assert names == list(returns(gate=gate)["behavior"])
    for ax in bars:
        totals = [text.get_text() for text in ax.texts]
        assert totals == (["−800", "−2,000", "−700", "−850"] if gate else ["−900", "−2,000", "−850"])
    if gate:
        assert "break-even 500" in [text.get_text() for text in figure.axes[-1].texts]
