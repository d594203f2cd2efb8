"""Summaries, smoothing and selection of episodes, by hand."""

from __future__ import annotations

import math
from typing import Any

import pandas as pd
import pytest

from dockctl.analysis.episodes import (
    by_start,
    describe_outcome,
    from_initial_poses,
    moving_average,
    smoothing_window,
    summarize,
)


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


def test_success_at_a_clearance_by_hand() -> None:
    """Clearances on both sides of the limits; one that was not measured counts for none of them."""
    docked = [row("docked", 10, clearance_m=c) for c in (0.05, 0.1, 0.29, 0.3, 0.7, None, math.nan)]
    others = [row("timeout", 10, clearance_m=2.0)] * 3
    found = summarize([*docked, *others], 0.5)["success_at_clearance_m"]
    assert {least: given["docked"] for least, given in found.items()} == {"0.1": 4, "0.3": 2, "0.5": 1}
    assert found["0.3"]["success"] == 0.2
    low, high = found["0.3"]["success_interval_95"]
    # Wilson: (p + z²/2n ± z √(p(1−p)/n + z²/4n²)) / (1 + z²/n), z = 1.959964
    z, p, n = 1.959964, 0.2, 10
    middle, width = p + z * z / (2 * n), z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    assert (low, high) == pytest.approx(
        ((middle - width) / (1 + z * z / n), (middle + width) / (1 + z * z / n)), abs=1e-6
    )
    assert summarize([row("docked", 10)], 0.5)["success_at_clearance_m"] is None


def test_contact_speeds_and_mean_changes() -> None:
    collisions = [row("collision", 5, contact_speed_mps=speed) for speed in (0.1, 0.3)]
    docked = [row("docked", 5, contact_speed_mps=empty, rudder_change_deg=2.0) for empty in (None, math.nan)]
    summary = summarize([*docked, *collisions], 0.5)
    assert summary["contact_speed_mps"] == pytest.approx({"mean": 0.2, "max": 0.3})
    assert summary["mean_of_docked"]["rudder_change_deg"] == 2.0
    earlier = summarize([row("docked", 5)], 0.5)
    assert earlier["contact_speed_mps"] is None
    assert "rudder_change_deg" not in earlier["mean_of_docked"]


def test_outcomes_differ_by_obstacle_and_by_phase_of_a_timeout() -> None:
    one_phase = describe_outcome(row("timeout", 1, phase=1))
    assert one_phase == "timeout"
    assert describe_outcome(row("timeout", 1, phase=0)) != one_phase
    assert "moored 3" in describe_outcome(row("collision", 1, collided_with="moored 3"))
    assert "harbor" in describe_outcome(row("collision", 1))
    docked = {describe_outcome(row("docked", 1, phase=phase)) for phase in (0, 1)}
    assert docked == {"docked"}


@pytest.mark.parametrize(("count", "window"), [(3, 10), (800, 20), (100_000, 100)])
def test_smoothing_window(count: int, window: int) -> None:
    assert smoothing_window(pd.DataFrame(index=range(count))) == window


def test_moving_average_starts_with_fewer_values() -> None:
    assert moving_average(pd.Series([2.0, 4.0, 6.0, 9.0]), 3).tolist() == pytest.approx([2, 3, 4, 19 / 3])


def test_exploring_and_retried_starts_are_left_out_unless_there_are_no_others() -> None:
    mixed = pd.DataFrame({"start_kind": ["pose", "retried", "exploring", "random"]})
    assert from_initial_poses(mixed)["start_kind"].tolist() == ["pose", "random"]
    _, others, kinds = by_start(mixed)
    assert (others["start_kind"].tolist(), kinds) == (["retried", "exploring"], "exploring or retried")
    exploring = mixed[mixed["start_kind"] == "exploring"]
    assert from_initial_poses(exploring).equals(exploring)
