"""What is read off a maneuver, against maneuvers whose numbers are known by construction."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd
import pytest

from dockctl.analysis.trajectories import Track
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


def test_the_turn_counts_from_where_the_heading_stays_within_the_tolerance() -> None:
    there_and_off_again = track([20, 4, 9, 3, -2, 60, 1], [0, 0, 0, 0, 0, 1, 1])
    said = measures.turn([there_and_off_again], TASK)
    assert said == "within 5° for the last 1.0 s before the intermediate pose; 1.0° off at the end"


@pytest.mark.parametrize(
    ("propeller_n", "said"),
    [
        ([0, -50, -50, 10, 40, 50], "1 of 1 end with the propeller ahead, from 9.0 m off"),
        ([0, 50, -50, 50, -50, 0], "0 of 1 end with the propeller ahead"),
        ([0, 50, 50, 50, 50, 50], "0 of 1 end with the propeller ahead"),  # it never came astern
    ],
)
def test_a_boat_that_comes_astern_is_stopped_ahead(propeller_n: list[float], said: str) -> None:
    assert measures.stop([track([0.0] * 6, [1] * 6, propeller_n)], TASK).endswith(f"; {said}")


def test_boats_that_never_get_to_the_intermediate_pose_are_counted() -> None:
    tracks = [track([0, 0, 0], [0, 0, 0]), track([0, 0, 0], [0, 0, 1])]
    assert "at second 1 and 1 of 2 never there" in measures.gate(tracks, TASK).replace(", 1 of", " and 1 of")
