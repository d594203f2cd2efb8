"""Paired comparison of policies, by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from dockctl.analysis.contrast import MEASURES, SUCCESS, contrasts
from dockctl.analysis.statistics import mean_difference, success_difference

DOCKED = {
    "random": {"old": [1, 1, 1, 0, 0, 1], "new": [1, 0, 1, 1, 1, 1]},
    "pose": {"old": [1, 1], "new": [0, 1]},
}
TIME_S = {"old": [40, 42, 44, 9, 9, 50], "new": [41, 7, 43, 39, 38, 48]}


def episodes(policy: str, kind: str, docked: list[int], time_s: list[float]) -> pd.DataFrame:
    rng = np.random.default_rng(len(policy))
    table = pd.DataFrame({"policy": policy, "start_kind": kind, "start": range(len(docked))})
    for measure in MEASURES:
        table[measure.column] = rng.uniform(0, 1, len(docked))
    return table.assign(
        outcome=["docked" if one else "timeout" for one in docked], time_s=time_s[: len(docked)]
    )


def two_policies() -> pd.DataFrame:
    """Episodes of two policies from the same starts."""
    return pd.concat(
        episodes(policy, kind, docked, [float(t) for t in TIME_S[policy]])
        for kind, policies in DOCKED.items()
        for policy, docked in policies.items()
    )


def test_pairs_are_episodes_from_one_start_in_which_both_dock() -> None:
    table = two_policies()
    (found,) = contrasts(table.sample(frac=1, random_state=3).sort_values("policy", ascending=False))
    assert (found.first, found.second, found.kind) == ("old", "new", "random")
    assert (found.only_first, found.only_second, found.p) == (1, 2, 1.0)
    old, new = (np.array(DOCKED["random"][name], bool) for name in ("old", "new"))
    assert found.compared[SUCCESS].difference == success_difference(old, new)
    (time,) = [means for measure, means in found.compared.items() if measure.column == "time_s"]
    assert time.difference == mean_difference(np.array([40.0, 44, 50]), np.array([41.0, 43, 48]))
    assert (time.first, time.second, time.difference.pairs) == (pytest.approx(134 / 3), 44, 3)


def test_a_single_pair_is_not_compared() -> None:
    table = two_policies()
    table.loc[table["start"] > 0, "outcome"] = "collision"
    (found,) = contrasts(table)
    assert list(found.compared) == [SUCCESS]


@pytest.mark.parametrize(
    ("value", "signed", "text"),
    [(0.583, False, "58.3"), (0.2, True, "+20.0"), (-0.0123, True, "−1.2"), (-0.0001, True, "0.0")],
)
def test_formatted_numbers(value: float, signed: bool, text: str) -> None:
    assert SUCCESS.text(value, signed=signed) == text


def test_a_degree_sign_has_no_space_before_it() -> None:
    (angle,) = (measure for measure in MEASURES if measure.unit == "°")
    assert angle.quantity(-7.823) == "−7.82°"
    assert angle.quantity(-7.823, 0.5, signed=True) == "−7.82 to +0.50°"
    assert SUCCESS.quantity(0.5) == "50.0 %"
