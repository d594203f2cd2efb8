"""The benchmarks fit the code that they measure: each can be loaded, with all that it imports by name."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.thorough  # imports the libraries that dockctl is compared with
def test_every_benchmark_can_be_imported() -> None:
    names = sorted(path.stem for path in BENCHMARKS.glob("*.py"))
    assert "bench" in names
    done = subprocess.run(
        [sys.executable, "-c", f"import {', '.join(['bench', *names])}"],
        cwd=BENCHMARKS,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
