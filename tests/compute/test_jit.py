"""The cache of compiled functions: used, never stale, optional."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

CALLEE = """
from dockctl.compute.jit import compiled

@compiled()
def callee(x):
    return x + {added}
"""
CALLER = """
from callee import callee
from dockctl.compute.jit import compiled

@compiled()
def caller(x):
    return 10 * callee(x)
"""
ASK = "from caller import caller; print(caller(1), sum(caller.stats.cache_hits.values()))"
NOWHERE = """
import numba.core.caching
numba.core.caching.CacheImpl._locator_classes = []
"""


def ask(folder: Path, before: str = "") -> tuple[int, int]:
    """Call the caller in a new process; return its result and the number of cache hits."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), *sys.path])}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-c", before + ASK], cwd=folder, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    answer, hits = done.stdout.split()
    return int(answer), int(hits)


@pytest.mark.slow
def test_a_function_is_cached_until_one_that_it_calls_changes(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(added=1))
    assert ask(tmp_path) == (20, 0)
    assert ask(tmp_path) == (20, 1)
    (tmp_path / "callee.py").write_text(CALLEE.format(added=2))
    assert ask(tmp_path) == (30, 0)


@pytest.mark.slow
def test_without_a_cache_folder_functions_are_compiled_in_every_process(tmp_path: Path) -> None:
    (tmp_path / "caller.py").write_text(CALLER)
    (tmp_path / "callee.py").write_text(CALLEE.format(added=1))
    assert ask(tmp_path, NOWHERE) == (20, 0)
