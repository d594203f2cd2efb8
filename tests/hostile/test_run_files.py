"""Files of a run made to crash or to exhaust the memory: one error each, and little memory."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dockctl.errors import DockctlError
from dockctl.experiments.archive import archive
from dockctl.runs.directory import RunDirectory
from dockctl.runs.reader import read_run
from tests.hostile.memory import at_most_mb
from tests.reports.synthetic import write_run

MB = 1_000_000
DEEP = "[" * 100_000 + "]" * 100_000
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


def compressed(unit: bytes, mb: int) -> bytes:
    return gzip.compress(unit * (mb * MB // len(unit)), 1)


SCENARIO = {
    "aliases": lambda: BOMB.encode(),
    "deep": lambda: b"a: " + DEEP.encode(),
    "large": lambda: b"# " + b"x" * 20 * MB,
    "tag": lambda: b"!!python/object/apply:os.system [touch marker]",
    "not text": lambda: b"\xff\xfe\x00",
}
JSON = {
    "deep": lambda: b'{"polygons": ' + DEEP.encode() + b"}",
    "NaN": lambda: b'{"bounds_m": [NaN, 0, 1, 2]}',
    "infinity": lambda: b'{"bounds_m": [0, 0, 1e999, 2]}',
    "large": lambda: b'{"a": "' + b"x" * 100 * MB + b'"}',
    "many values": lambda: b"[" + b"[]," * (20 * MB) + b"[]]",
    "not text": lambda: b"\xff\xfe\x00",
    "another archive": lambda: b'{"archived_as": "/dev/zero"}',
    "the archive is a number": lambda: b'{"archived_as": 3}',
}
TABLE = {
    "large": lambda: b"a,b\n" + b"1,2\n" * (30 * MB),
    "many columns": lambda: b"a," * (5 * MB),
    "a row of many cells": lambda: b"a\n" + b"1," * (5 * MB),
    "a header of many lines": lambda: b'"\n",' * (5 * MB),
    "an open quote": lambda: b'a,"b\n1,2\n',
    "one long cell": lambda: b"a\n" + b"x" * 40 * MB,
    "null bytes": lambda: b"\x00" * MB,
    "not text": lambda: b"\xff\xfe,\xff\n1,2\n",
}
CASES = [
    *(("scenario.yaml", name, make) for name, make in SCENARIO.items()),
    *(("scene.json", name, make) for name, make in JSON.items()),
    *(("episodes.csv", name, make) for name, make in TABLE.items()),
]


@pytest.mark.parametrize(("name", "kind", "make"), CASES, ids=[f"{name}: {kind}" for name, kind, _ in CASES])
def test_a_run_is_read(
    tmp_path: Path, name: str, kind: str, make: Callable[[], bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = write_run(tmp_path / "run", count=20)
    content = make()
    (folder / name).write_bytes(content)
    del content
    with at_most_mb(300), pytest.raises(DockctlError) as caught:
        read_run(folder)
    assert str(folder) in str(caught.value) or kind == "another archive"
    assert not Path("marker").exists()


@pytest.mark.parametrize("unit", [b" ", b"[],", b"1,\n"])
@pytest.mark.parametrize("name", ["scene.json.gz", "episodes.csv.gz"])
def test_what_expands_a_hundred_times(tmp_path: Path, name: str, unit: bytes) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / name.removesuffix(".gz")).unlink()
    (folder / "scene.json").write_text(json.dumps({"archived_as": "scene.json.gz"}))
    content = compressed(unit, 200)
    assert len(content) < 5 * MB
    (folder / name).write_bytes(content)
    with at_most_mb(300), pytest.raises(DockctlError):
        read_run(folder)


@pytest.mark.parametrize("name", ["scenario.yaml", "scene.json", "episodes.csv", "trajectories.csv"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, name: str) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with pytest.raises(DockctlError):
        read_run(folder)


@pytest.mark.parametrize("kind", [kind for kind in JSON if "archive" not in kind])
def test_facts_about_a_run(tmp_path: Path, kind: str) -> None:
    (tmp_path / "provenance.json").write_bytes(JSON[kind]())
    with at_most_mb(300), pytest.raises(DockctlError):
        RunDirectory(tmp_path).read_json("provenance.json")


def test_a_run_that_is_archived(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", count=20)
    (folder / "evaluation.csv").write_bytes(b"x" * 100 * MB)
    with at_most_mb(300), pytest.raises(DockctlError):
        archive(folder, tmp_path / "results", "experiment", 0)


def test_the_memory_of_these_tests_is_measured() -> None:
    with pytest.raises(AssertionError), at_most_mb(300):  # the system may take other pages back meanwhile
        np.ones(800 * MB // 8).sum()
