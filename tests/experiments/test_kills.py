"""A training that is killed again and again ends like one that is not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

KILLS = os.environ.get("DOCKCTL_KILLS", "3")


@pytest.mark.slow
@pytest.mark.thorough  # tests/commands/test_resume.py kills one training
def test_a_killed_training_ends_like_one_that_was_not_killed() -> None:
    command = [sys.executable, "-m", "tests.experiments.kills", KILLS]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"{KILLS} kills ")
