"""Conditions that cannot be combined, and names of conditions that would hide a result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dockctl.errors import InputError
from dockctl.experiments.dry_run import dry_run
from dockctl.scenarios.loader import load
from dockctl.sim.checks import load_checked
from tests.sim.conditions.conditions import simulator

WIND = "{kind: wind, speed_mps: 1, direction_deg: 0}"
NOISE = "{kind: lidar_noise, sigma_m: 0.1}"
ACTUATORS = "{kind: actuators, delay_steps: 1}"
DEPTH = "{kind: shallow_water, depth_m: 1}"
CURRENT = "{kind: current, speed_mps: 0.1, direction_deg: 0}"


def scenario(folder: Path, conditions: str) -> Path:
    file = folder / "mine.yaml"
    file.write_text(f"extends: s1\nconditions:\n{conditions}")
    return file


@pytest.mark.parametrize("given", [WIND, NOISE, DEPTH, ACTUATORS])
def test_two_that_do_not_add_up_are_refused(given: str, tmp_path: Path) -> None:
    file = scenario(tmp_path, f"  one: {given}\n  other: {given}\n")
    with pytest.raises(InputError) as caught:
        load_checked(file)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (4, "conditions.other", "mismatch")
    assert "'one'" in problem.message


def test_two_currents_add_up(tmp_path: Path) -> None:
    load_checked(scenario(tmp_path, f"  stream: {CURRENT}\n  tide: {CURRENT}\n"))


def test_a_condition_does_not_hide_a_result(tmp_path: Path) -> None:
    """`contact_speed_mps` is the speed at a collision."""
    with pytest.raises(InputError) as caught:
        dry_run(load(scenario(tmp_path, f"  stream: {CURRENT}\n  contact: {CURRENT}\n")))
    (problem,) = caught.value.problems
    assert (problem.line, problem.field, problem.code) == (4, "conditions.contact", "duplicate")
    assert "contact_speed_mps" in problem.message


def test_a_condition_draws_the_same_with_and_without_others() -> None:
    """Also during the episode; so a comparison with one of them changed is in otherwise equal weather."""
    gusts = "wind: {speed_mps: [0, 5], direction_deg: [0, 360], gust_mps: [0, 1.5]}"
    others = "uncertainty: {masses: 0.2}, tide: {kind: current, speed_mps: [0, 0.1], direction_deg: [0, 360]}"
    air, drawn = [], []
    for conditions in (gusts, f"{others}, {gusts}"):
        sim = simulator(conditions, boats=3)
        drawn.append({key: value for key, value in sim.disturbances.episode().items() if "wind" in key})
        for _ in range(3):
            sim.disturbances.advance(0.5)
            air.append(sim.wind())
    assert drawn[0].keys() == drawn[1].keys() and len(drawn[0]) == 3
    for key, value in drawn[0].items():
        np.testing.assert_array_equal(value, drawn[1][key])
        assert len(set(value)) == 3
    np.testing.assert_array_equal(air[:3], air[3:])
