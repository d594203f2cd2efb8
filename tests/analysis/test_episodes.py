"""Summaries, smoothing and selection of episodes, by hand."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest

from dockctl.analysis.episodes import ending, from_initial_poses, moving_average, smoothing_window, summarize


def row(outcome: str, steps: int, **values: Any) -> dict[str, Any]:
    """An episode; everything that is not given is the same in all."""
    same = {"collided_with": "", "phase": 1, "return": 1.0, "distance_m": 0.5, "heading_error_deg": -6.0}
    more = {"speed_mps": 0.3, "path_length_m": float(steps), "clearance_m": None, "control_changes": 0.0}
    return {"outcome": outcome, "steps": steps, **same, **more, **values}


def test_summary() -> None:
    episodes = [
        row("docked", 10),
        row("docked", 20, clearance_m=0.4, heading_error_deg=4.0),
        row("collision", 5, collided_with="moored 3", clearance_m=0.0),
        row("timeout", 30, phase=0),
    ]
    summary = summarize(episodes, 0.5)
    assert (summary["docked"], summary["episodes"], summary["success"]) == (2, 4, 0.5)
    assert list(summary["endings"].values()) == [2, 1, 1]
    assert summary["least_clearance_m"] == 0.0
    means = summary["mean_of_docked"]
    assert (means["steps"], means["time_s"], means["path_length_m"]) == (15, 7.5, 15)
    assert means["heading_error_deg"] == pytest.approx(5.0)
    assert summarize(episodes[2:], 0.5)["mean_of_docked"] is None
    assert summarize([], 0.5)["success"] is None


def test_endings_differ_by_obstacle_and_by_phase_of_a_timeout() -> None:
    one_phase = ending(row("timeout", 1, phase=1))
    assert one_phase == "timeout"
    assert ending(row("timeout", 1, phase=0)) != one_phase
    assert "moored 3" in ending(row("collision", 1, collided_with="moored 3"))
    assert "harbor" in ending(row("collision", 1))
    assert ending(row("docked", 1, phase=0)) == ending(row("docked", 1, phase=1)) == "docked"


@pytest.mark.parametrize(("count", "window"), [(3, 10), (800, 20), (100_000, 100)])
def test_smoothing_window(count: int, window: int) -> None:
    assert smoothing_window(pd.DataFrame(index=range(count))) == window


def test_moving_average_starts_with_fewer_values() -> None:
    assert moving_average(pd.Series([2.0, 4.0, 6.0, 9.0]), 3).tolist() == pytest.approx([2, 3, 4, 19 / 3])


def test_exploring_starts_are_left_out_unless_there_are_no_others() -> None:
    mixed = pd.DataFrame({"start_kind": ["pose", "exploring", "random"]})
    assert from_initial_poses(mixed)["start_kind"].tolist() == ["pose", "random"]
    exploring = mixed[mixed["start_kind"] == "exploring"]
    assert from_initial_poses(exploring).equals(exploring)
