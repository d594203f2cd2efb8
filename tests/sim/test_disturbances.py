"""Conditions that cannot be combined, and names of conditions that would hide a result."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.errors import InputError
from dockctl.experiments.dry_run import dry_run
from dockctl.scenarios.loader import load
from dockctl.sim.checks import load_checked

WIND = "{kind: wind, speed_mps: 1, direction_deg: 0}"
NOISE = "{kind: lidar_noise, sigma_m: 0.1}"
DEPTH = "{kind: shallow_water, depth_m: 1}"
CURRENT = "{kind: current, speed_mps: 0.1, direction_deg: 0}"


def scenario(folder: Path, conditions: str) -> Path:
    file = folder / "mine.yaml"
    file.write_text(f"extends: s1\nconditions:\n{conditions}")
    return file


@pytest.mark.parametrize("given", [WIND, NOISE, DEPTH])
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
