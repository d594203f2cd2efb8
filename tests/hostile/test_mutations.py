"""Damaged files of a run: every command that reads them works or reports one error, without a traceback.

``DOCKCTL_MUTATIONS=2000`` makes more of them.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import settings
from safetensors.numpy import load, save

from dockctl.agents.divergence import DivergenceError
from dockctl.errors import DockctlError
from dockctl.experiments import export, model_card
from dockctl.reports.figures import figures
from dockctl.runs.directory import RunDirectory
from dockctl.runs.reader import read_run
from tests.commands.conftest import Outcome, dockctl, only_run, quick_train

COUNT = int(os.environ.get("DOCKCTL_MUTATIONS", settings.default.max_examples))
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 3.5, 1e300, -1e300, 10**18, 10**400, float("nan"), float("inf")),
    *("", "x", "nan", "../..", "/dev/null", "\x00", "\ud800", "ß" * 300, [], {}, [[]], [None], {"a": 1}),
    *([1, 2], ["x"], [[0, 1], [2, 3]], {"kind": "x"}, {"": {"": {}}}),
)
CELLS = ("", "nan", "inf", "-1", "1e400", "x", "docked", "3.5", '"', ",", "\x00", "2026-01-01", "ß", "True")


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value in JSON data."""
    yield path
    items = value.items() if isinstance(value, dict) else enumerate(value if isinstance(value, list) else ())
    for key, item in items:
        yield from places(item, (*path, key))


def change(value: Any, path: tuple[Any, ...], rng: np.random.Generator) -> Any:
    """Return data with another value at `path`, or without it."""
    if not path:
        return VALUES[rng.integers(len(VALUES))]
    key, *rest = path
    copy = dict(value) if isinstance(value, dict) else list(value)
    if not rest and rng.random() < 0.2:
        del copy[key]
    else:
        copy[key] = change(copy[key], tuple(rest), rng)
    return copy


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Cut bytes off, out or in, or change one."""
    at, to = sorted(rng.integers(len(content) + 1, size=2))
    kind = rng.integers(4)
    if kind == 0:
        return content[:at]
    if kind == 1:
        return content[:at] + content[to:]
    if kind == 2:
        return content[:to] + content[at:]
    return content[:at] + bytes([rng.integers(256)]) + content[at + 1 :]


def mutate(path: Path, rng: np.random.Generator) -> None:
    """Damage a file: its bytes, or its data with the right syntax and hashes."""
    content = path.read_bytes()
    name = path.name
    if rng.random() < 0.25:
        path.write_bytes(damaged(content, rng))
    elif name.endswith((".json", ".yaml")):
        data = json.loads(content) if name.endswith(".json") else yaml.safe_load(content)
        listed = list(places(data))
        for _ in range(rng.integers(1, 4)):
            try:
                data = change(data, listed[rng.integers(len(listed))], rng)
            except (LookupError, TypeError):  # an earlier change removed it
                continue
        if isinstance(data, dict) and "facts_sha256" in data:
            del data["facts_sha256"]
            hashed = hashlib.sha256(json.dumps(data, sort_keys=True).encode()).hexdigest()
            data["facts_sha256"] = hashed
        path.write_text(json.dumps(data) if name.endswith(".json") else yaml.safe_dump(data))
    elif name.endswith(".csv"):
        rows = [line.split(",") for line in content.decode().splitlines()]
        row = rows[rng.integers(len(rows)) if rng.random() < 0.8 else 0]
        row[rng.integers(len(row))] = CELLS[rng.integers(len(CELLS))]
        path.write_text("\n".join(map(",".join, rows)) + "\n", errors="replace")
    else:
        tensors = load(content)
        key = sorted(tensors)[rng.integers(len(tensors))]
        kind = rng.integers(4)
        if kind == 0:
            del tensors[key]
        elif kind == 1:
            tensors[key] = tensors[key].astype((np.float16, np.int8, np.float64)[rng.integers(3)])
        elif kind == 2:
            tensors[key] = np.atleast_1d(tensors[key])[..., :0]
        else:
            tensors[key] = np.full_like(tensors[key], (0, 1, 100)[rng.integers(3)])
        path.write_bytes(save(tensors))
        rehash(path)


def rehash(path: Path) -> None:
    facts_file = path.with_suffix(".json")
    facts = json.loads(facts_file.read_text()) | {"sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    if "facts_sha256" in facts:
        del facts["facts_sha256"]
        facts["facts_sha256"] = hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()
    facts_file.write_text(json.dumps(facts))


def evaluate(run: Path) -> Outcome:
    return dockctl("evaluate", "--ckpt", run, "--episodes", 0)


def plot(run: Path) -> None:
    """Draw the cheap figures of ``dockctl plot``; the others use the same rows."""
    for _ in figures(read_run(run)):
        pass


def export_(run: Path) -> Outcome:
    return dockctl("export", run, "--name", "x", "--out", run.parent / "out")


def resume(run: Path) -> Outcome:
    return dockctl("train", "--resume", run, "--steps", 320)


def record(run: Path) -> Outcome:
    return dockctl("evaluate", run, "--episodes", 0, "--record", run.parent / "recording")


def map_(run: Path) -> Outcome:
    return dockctl("map", "--ckpt", run, "--reach-m", 0, "--headings", 0, "--out", run.parent / "map")


def returns(run: Path) -> Outcome:
    return dockctl("returns", "--ckpt", run, "--out", run.parent / "returns")


def compare(run: Path) -> Outcome:
    return dockctl("compare", run, "s1", "--episodes", 0, "--out", run.parent / "compare")


READERS: dict[str, tuple[Callable[[Path], Any], ...]] = {
    "scenario.yaml": (evaluate, plot, resume, export_, record),
    "provenance.json": (resume, export_),
    "scene.json": (plot,),
    "episodes.csv": (plot, resume),
    "updates.csv": (plot, resume),
    "evaluations.csv": (plot, resume),
    "timing.csv": (resume,),
    "trajectories.csv": (plot,),
    "evaluation.csv": (export_,),
    "evaluation.json": (export_,),
    "map.csv": (export_,),
    "map.json": (export_,),
    "figures/latency.json": (export_,),
    "checkpoints/best/policy.json": (evaluate, record, map_, returns, compare, export_),
    "checkpoints/best/policy.safetensors": (evaluate, compare),
    "LAST/policy.json": (resume,),
    "LAST/policy.safetensors": (resume,),
    "LAST/learner.json": (resume,),
    "LAST/learner.safetensors": (resume,),
}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short training with all measurements, stopped before its end."""
    out = tmp_path_factory.mktemp("runs")
    outcome = quick_train(out, "s1", "--seed", 3, "--steps", 300)
    assert outcome.code == 0, outcome.err
    run = only_run(out)
    for words in (
        ("evaluate", "--episodes", 3),
        ("map", "--reach-m", 1, "--step-m", 1, "--headings", 0),
        ("latency", "--decisions", 10),
    ):
        outcome = dockctl(*words, "--ckpt", run)
        assert outcome.code == 0, outcome.err
    return run


@pytest.fixture(autouse=True)
def _cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    """Export any policy: those of a short training do not dock."""
    episodes = export.training_episodes
    monkeypatch.setattr(export, "training_episodes", lambda policy, loaded: episodes(policy, loaded)[:0])
    monkeypatch.setattr(export, "_table", lambda _: export.pd.DataFrame(columns=model_card.EPISODES))


@pytest.mark.parametrize("name", READERS)
def test_a_damaged_file(original: Path, tmp_path: Path, name: str) -> None:
    readers = READERS[name]
    rng = np.random.default_rng([len(name), *name.encode()])
    for number in range(max(1, COUNT // len(READERS))):
        folder = tmp_path / str(number)
        shutil.copytree(original, folder / "run")
        last, *older = RunDirectory(folder / "run").checkpoints("last")
        for previous in older:  # would be used instead
            shutil.rmtree(previous)
        mutate(folder / "run" / name if not name.startswith("LAST/") else last / name[5:], rng)
        for reader in readers[number % len(readers) :][:1]:
            try:
                outcome = reader(folder / "run")
            except DockctlError:
                continue
            assert outcome is None or outcome.code in (0, 2, DivergenceError.exit_code), outcome.err
        shutil.rmtree(folder)
