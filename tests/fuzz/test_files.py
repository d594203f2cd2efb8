"""Mutated mesh files and tables of runs: each is read, or gives an error."""

from __future__ import annotations

import os
import random
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from dockctl.errors import DockctlError
from dockctl.runs import tables
from dockctl.runs.reader import read_table
from dockctl.scenarios.harbor import VESSEL_MODELS, MeshFile
from dockctl.sim.harbor.mesh_files import load_bodies, read_model

CASES = int(os.environ.get("DOCKCTL_FUZZ_CASES", "200"))
NUMBERS = (b"0", b"-1", b"1e308", b"nan", b"inf", b"99999999999999999999", b"4294967295", b"", b"x")


def mutated(content: bytes, rng: random.Random) -> bytes:
    """Return the content with a few bytes, numbers or ranges changed."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 5))):
        place, length = rng.randrange(len(data) + 1), rng.choice((1, 2, 4, 30, 300))
        action = rng.randrange(6)
        if action == 0:
            data[place : place + length] = rng.randbytes(length)
        elif action == 1:
            del data[place : place + length]
        elif action == 2:
            data[place:place] = data[place : place + length] * rng.choice((1, 2, 20))
        elif action == 3:
            data[place : place + 4] = rng.choice((0, 1, 2**31, 2**32 - 1)).to_bytes(4, "little")
        else:  # a number of a text, or of the header of a binary file
            digits = [i for i, code in enumerate(data[:4000]) if chr(code).isdigit()]
            if digits:
                first = last = rng.choice(digits)
                while last < len(data) and chr(data[last]).isdigit():
                    last += 1
                data[first:last] = rng.choice(NUMBERS)
    return bytes(data)


def run_cases(
    contents: dict[str, bytes], read: Callable[[Path], Any], folder: Path
) -> tuple[Counter[str], list[str]]:
    """Read mutations of files, and return the numbers of outcomes and what is wrong."""
    counts, faults = Counter[str](), []
    names = sorted(contents)
    for case in range(CASES):
        rng = random.Random(case)
        name = rng.choice(names)
        path = folder / f"{case}-{name}"
        path.write_bytes(mutated(contents[name], rng))
        try:
            read(path)
            counts["read"] += 1
        except DockctlError:
            counts["errors"] += 1
        except Exception:  # a crash is what the test looks for
            counts["crashed"] += 1
            faults.append(f"case {case}, {name}: {traceback.format_exc()}")
        path.unlink()
    print(f"{CASES} cases: {dict(counts)}")
    return counts, faults


@pytest.mark.slow
def test_meshes(tmp_path: Path) -> None:
    box = trimesh.creation.box((4, 3, 2)).subdivide()
    contents = {}
    for kind in ("glb", "obj", "ply", "stl", "stl_ascii"):
        data: Any = box.export(file_type=kind)
        contents[f"{kind}.{kind[:3]}"] = data if isinstance(data, bytes) else data.encode()
    contents["ascii.ply"] = box.export(file_type="ply", encoding="ascii")
    contents["model.obj"] = (VESSEL_MODELS / "dinghy.obj").read_bytes()

    def read(path: Path) -> None:
        if "model" in path.name:
            assert np.isfinite(read_model(path).mesh.vertices).all()
            return
        for body in load_bodies(MeshFile(path=path.name), path.parent, "harbor.meshes.0.path"):
            assert np.isfinite(body.vertices).all()
            assert body.faces.max() < len(body.vertices)

    counts, faults = run_cases(contents, read, tmp_path)
    assert not faults, "\n\n".join(faults[:10])
    assert min(counts["read"], counts["errors"]) > 0.1 * CASES


@pytest.mark.slow
def test_tables_of_runs(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    rows = [
        {name: rng.uniform() for name in tables.EPISODES}
        | {"env_steps": step, "start_kind": "pose", "outcome": "docked"}
        for step in range(100, 3000, 100)
    ]
    text = tables.to_csv(rows, tables.EPISODES).encode()
    contents = {
        "episodes.csv": text,
        "plain.csv": text.replace(b",", b" "),
        "digits.csv": text.replace(b"1", "²".encode()),
    }

    def read(path: Path) -> None:
        table = read_table(path, tables.EPISODES)
        assert table is None or len(table) <= 100 * len(rows)
        resumed = tables.Table(path, tables.EPISODES)
        resumed.restore(None, 1500)
        resumed.append(rows[:1])

    counts, faults = run_cases(contents, read, tmp_path)
    assert not faults, "\n\n".join(faults[:10])
    assert counts["read"] > 0 < counts["errors"]
