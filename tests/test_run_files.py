"""The file names of a run folder are written in one place."""

from __future__ import annotations

import ast
from pathlib import Path

from dockctl import run_files

ROOT = Path(__file__).parents[1]
CODE = ("dockctl", "studies", "benchmarks", "tools", "examples")
NAMES = {
    value
    for name, value in vars(run_files).items()
    if name.isupper() and isinstance(value, str) and value.endswith((".csv", ".json", ".yaml"))
}


def test_only_run_files_writes_the_file_names() -> None:
    assert {"scenario.yaml", "provenance.json", "timing.csv"} <= NAMES
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for folder in CODE
        for path in (ROOT / folder).rglob("*.py")
        if path != Path(run_files.__file__)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        if node.value.rpartition("/")[2] in NAMES
    ]
    assert found == []
