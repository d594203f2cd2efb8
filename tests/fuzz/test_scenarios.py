"""Mutated scenario files: each is valid and can be stepped, or gives errors with file, line and column.

``DOCKCTL_FUZZ_CASES=10000 pytest -s tests/fuzz/test_scenarios.py`` runs that many cases.
"""

from __future__ import annotations

import os
import traceback
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import InputError, Problem
from dockctl.scenarios.loader import LoadedScenario
from dockctl.sim.checks import load_checked
from dockctl.sim.lidar.spinning import SpinningLidars
from tests.fuzz.scenario_files import bases, write_case

FIRST = int(os.environ.get("DOCKCTL_FUZZ_FIRST", "0"))
CASES = int(os.environ.get("DOCKCTL_FUZZ_CASES", 4 * settings.default.max_examples))


def fault(path: Path) -> tuple[str, str]:
    """Return the outcome of a scenario file, and what is wrong with dockctl, if anything."""
    try:
        try:
            loaded = load_checked(path)
        except InputError as error:
            wrong = [str(problem) for problem in error.problems if not is_located(problem, path.parent)]
            return "errors", "\n".join(wrong)
        return "valid", step(loaded)
    except Exception:  # a crash is what the test looks for
        return "crashed", traceback.format_exc()


def is_located(problem: Problem, folder: Path) -> bool:
    """Return whether a problem is at a place in a file of the scenario."""
    file = Path(problem.file)
    if not (file.parent == folder or "scenarios" in file.parts) or not file.is_file():
        return False
    lines = file.read_bytes().decode("utf-8", "replace").splitlines(keepends=True) or [""]
    lines = "".join(lines).replace("\r\n", "\n").split("\n")
    return 1 <= problem.line <= len(lines) + 1 and problem.column >= 1


def step(loaded: LoadedScenario) -> str:
    """Step two boats, and return what is not finite; spinning LiDARs get few rays, because they take long."""
    lidar = loaded.scenario.sensors.lidar
    if isinstance(lidar, SpinningLidars):
        few = lidar.model_copy(update={"azimuth_steps": 8, "channels": min(lidar.channels, 4)})
        sensors = loaded.scenario.sensors.model_copy(update={"lidar": few})
        scenario = loaded.scenario.model_copy(update={"sensors": sensors})
        loaded = LoadedScenario(scenario, loaded.base_dir, loaded.source, loaded.plugin_files)
    env = DockingVectorEnv(loaded, 2)
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    for _ in range(2):
        finite = np.isfinite(observation).all()
        observation, reward, _, _, _ = env.step(env.action_space.sample())
        if not (finite and np.isfinite(observation).all() and np.isfinite(reward).all()):
            return f"not finite: {observation}, {reward}"
    return ""


@pytest.mark.slow
def test_every_case_is_valid_and_can_be_stepped_or_gives_located_errors(tmp_path: Path) -> None:
    given, counts, faults = bases(), Counter[str](), []
    for case in range(FIRST, FIRST + CASES):
        folder = tmp_path / str(case)
        folder.mkdir()
        outcome, wrong = fault(write_case(case, folder, given))
        counts[outcome] += 1
        if wrong:
            faults.append(f"case {case}, {outcome}: {wrong}")
    print(f"{CASES} cases: {dict(counts)}, {len(faults)} faults")
    assert not faults, "\n\n".join(faults[:20])
    assert min(counts["valid"], counts["errors"]) > 0.05 * CASES  # the cases test both
