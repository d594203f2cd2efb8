"""Random arguments on the command line: an exit code of 0, 1 or 2, never a traceback."""

from __future__ import annotations

import os
import random
from collections import Counter
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from dockctl import cli
from dockctl.plugins import SCENARIOS
from dockctl.scenarios import catalog

CASES = int(os.environ.get("DOCKCTL_FUZZ_CASES", "60"))
VALUES = [
    "",
    " ",
    "0",
    "-1",
    "1",
    "nan",
    "inf",
    "1e308",
    "é",
    "x" * 5000,
    "\u202e",
    "a\nb",
    ".",
    "..",
    "/",
    "/dev/null",
]
VALUES += [
    "nope",
    "x.yaml",
    "x.py",
    "x.py:f",
    ":x",
    "x:",
    ":",
    "no_module:x",
    "x.onnx",
    "x.zip",
    "x.zip:DQN",
    "=",
    "a=b",
]
VALUES += [
    "task.max_steps=0",
    "a.b=[",
    ".=1",
    "1,2,3",
    "1,2,nan",
    ",",
    "20,1",
    "rewards",
    "--",
    "-",
    "--set",
    "-h",
    "/proc/self/mem",
]
runner = CliRunner()


def arguments(rng: random.Random) -> list[str]:
    """Return a command with some of its options, and values that are often wrong."""
    group = get_command(cli.app)
    command = rng.choice([*(name for name in cli.COMMANDS if name != "reproduce"), "", "nope", "--version"])
    words = [command] if command else []
    known = group.commands.get(command)  # type: ignore[attr-defined]  # a group of commands
    options = [
        name for param in (known.params if known else ()) for name in param.opts if name.startswith("-")
    ]
    for _ in range(rng.randrange(4)):
        if options and rng.random() < 0.6:
            words.append(rng.choice(options))
        if rng.random() < 0.8:
            words.append(rng.choice(VALUES))
    return words


@pytest.mark.slow
def test_any_arguments_end_with_an_exit_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "x.py").write_text("f = 3\n")
    (tmp_path / "x.zip").write_text("no archive")
    (tmp_path / "x.onnx").write_text("no model")
    (tmp_path / "x.yaml").write_text("extends: s1\nsensors: {lidar: {kind: planar, rays: 8}}\nvessel: 3\n")
    catalog.fill()
    for name in SCENARIOS.names():  # a file comes before a registered scenario, with which commands take long
        (tmp_path / name).write_text("extends: 3\n")
    counts, faults = Counter[int](), []
    for case in range(CASES):
        words = arguments(random.Random(case))
        result = runner.invoke(cli.app, words)
        counts[result.exit_code] += 1
        known = result.exception is None or isinstance(result.exception, SystemExit)
        if not known or result.exit_code not in (0, 1, 2):
            faults.append(f"case {case}: {words}: {result.exit_code}, {result.exception!r}")
    print(f"{CASES} cases: {dict(counts)}")
    assert not faults, "\n".join(faults[:10])
    assert counts[0] > 0 < counts[2]
