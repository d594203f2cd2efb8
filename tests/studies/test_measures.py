"""Measures of maneuvers, on maneuvers with known numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence

import pandas as pd
import pytest

from dockctl.reports.plan_view import Track
from dockctl.scenarios.loader import load
from studies.thesis import measures

TASK = load("s3").scenario.task


def track(
    errors_deg: Sequence[float], phases: Sequence[int], propeller_n: Sequence[float] | None = None
) -> Track:
    """One row every half second, each 0.5 m nearer to a goal that is never reached."""
    count = len(errors_deg)
    table = pd.DataFrame(
        {
            "time_s": [0.5 * row for row in range(count)], "heading_error_deg": errors_deg, "phase": phases,
            "distance_m": [10 - 0.5 * row for row in range(count)], "u_mps": -0.4, "v_mps": 0.0,
            "propeller_n": propeller_n if propeller_n is not None else 0.0,
        }
    )  # fmt: skip
    return Track("a track", "red", table)


def numbers(text: str) -> list[str]:
    return re.findall(r"[\d.]*\d", text)


def test_turn_counts_from_where_the_heading_stays_within_the_tolerance() -> None:
    there_and_off_again = track([20, 4, 9, 3, -2, 60, 1], [0, 0, 0, 0, 0, 1, 1])
    text = measures.turn([there_and_off_again], TASK)
    assert numbers(text) == ["5", "1.0", "1.0"]


@pytest.mark.parametrize(
    ("propeller_n", "expected"),
    [
        ([0, -50, -50, 10, 40, 50], ["1", "1", "9.0"]),
        ([0, 50, -50, 50, -50, 0], ["0", "1"]),
        ([0, 50, 50, 50, 50, 50], ["0", "1"]),  # it never came astern
    ],
)
def test_boat_astern_is_stopped_by_thrust_ahead(propeller_n: list[float], expected: list[str]) -> None:
    text = measures.stop([track([0.0] * 6, [1] * 6, propeller_n)], TASK)
    assert numbers(text.rpartition(";")[2]) == expected


def test_missed_intermediate_poses_are_counted() -> None:
    tracks = [track([0, 0, 0], [0, 0, 0]), track([0, 0, 0], [0, 0, 1])]
    text = measures.intermediate(tracks, TASK)
    assert numbers(text)[:3] == ["1", "1", "2"]
