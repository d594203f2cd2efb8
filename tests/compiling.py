"""Compile what most tests and their processes need, in parts that take about equally long."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np


def compile_simulator(scenario: str = "s1") -> None:
    from dockctl.envs.vector import DockingVectorEnv

    environment = DockingVectorEnv(scenario, 2)
    environment.reset(seed=0)
    environment.step(np.zeros(2, np.int64))


def compile_learner() -> None:
    from dockctl.runs.directory import RunDirectory
    from dockctl.scenarios.training import Training
    from tests.agents.test_trainer import SETTINGS, trainer_in

    short = {"total_steps": 40, "warmup_steps": 10, "batch_size": 8, "stop": None}
    with tempfile.TemporaryDirectory() as folder:
        trainer_in(RunDirectory(Path(folder)), Training(**{**SETTINGS, **short})).run()


def compile_noise() -> None:
    compile_simulator("s1-weather")


PARTS = {"simulator": compile_simulator, "learner": compile_learner, "noise": compile_noise}

if __name__ == "__main__":
    for compile_part in PARTS.values():
        compile_part()
