"""Files of policies: NumPy archives and ONNX models, and what is none."""

from __future__ import annotations

import io
import json
import math
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dockctl.errors import DockctlError
from dockctl.experiments.portable import export_files
from dockctl.pilot import Pilot, Reading
from tests.pilot.inputs import AWAY, INTERMEDIATE


def zip_of(member: bytes, flags: int) -> bytes:
    """Return an archive of one array, whose headers have these flags."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("x.npy", member)
    archived = bytearray(content.getvalue())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        archived[archived.index(signature) + offset] |= flags
    return bytes(archived)


def test_files_that_are_no_policy(s3_pilot: Path, tmp_path: Path) -> None:
    def code_of(path: Path, **given: Any) -> str:
        with pytest.raises(DockctlError) as caught:
            Pilot.load(path, **given)
        return caught.value.code

    assert code_of(tmp_path / "none.npz") == "not_found"
    assert code_of(tmp_path) == "not_readable"
    content = s3_pilot.read_bytes()
    damaged = tmp_path / "damaged.npz"
    header = io.BytesIO()
    description = {"descr": "<f4", "fortran_order": False, "shape": (10**13,)}
    np.lib.format.write_array_header_1_0(header, description)
    huge, encrypted = (zip_of(header.getvalue(), flags) for flags in (0, 1))
    compressed = io.BytesIO()
    np.savez_compressed(compressed, zeros=np.zeros(10**6))
    for flawed in (
        b"", b"text", content[:-100], content[:5000] + b"\xff" + content[5001:],
        huge, encrypted, compressed.getvalue(),
    ):  # fmt: skip
        damaged.write_bytes(flawed)
        assert code_of(damaged) == "not_readable"
    with np.load(s3_pilot) as arrays:
        tensors = {name: arrays[name] for name in arrays.files}
    facts = json.loads(str(tensors["description"]))
    changes: list[dict[str, Any]] = [
        {"description": np.array("{}")},
        {"description": np.array("[" * 100_000)},
        {"description": np.array(json.dumps({**facts, "format": 2}))},
        {"description": np.array(json.dumps({**facts, "max_steps": math.inf}))},
        {"description": np.array(json.dumps({**facts, "control_period_s": -0.5}))},
        {"description": np.array(json.dumps({**facts, "commands": [[math.nan, 0]] * 77}))},
        {"description": np.array(json.dumps({**facts, "commands": [[0]] * 77}))},
        {"description": np.array(json.dumps({**facts, "lidar": {"sectors": 0, "range_m": 100}}))},
        {"description": np.array(json.dumps({**facts, "lidar": {"sectors": 10**11, "range_m": 100}}))},
        {"description": np.array(json.dumps({**facts, "commands": facts["commands"][:-1]}))},
        {"shared.0.weight": np.full_like(tensors["shared.0.weight"], np.nan)},
        {"shared.2.weight": tensors["shared.2.weight"][:, 1:]},
        {"more": np.zeros(1)},
    ]
    for change in changes:
        np.savez(damaged, **{**tensors, **change})
        assert code_of(damaged) == "not_readable"
    for final in ((1.0, 2.0), (10**400, 0, 0), (1e300, 0, 0), np.ma.masked_all(3)):
        assert code_of(s3_pilot, final=final) == "wrong_type"


@pytest.mark.parametrize("name", ["s3", pytest.param("marinas", marks=pytest.mark.thorough)])
def test_an_onnx_model_decides_the_same(name: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    files = tmp_path / "policy.npz", tmp_path / "policy.onnx"
    export_files([Path(name)], files[1], files[0])
    pilots, rng = [Pilot.load(file) for file in files], np.random.default_rng(0)
    for step in range(100):
        pose = Reading(step, [*AWAY[:2], rng.uniform(-3, 3)] + rng.uniform(-1, 1, 3))
        velocity = Reading(step, rng.uniform(-0.15, 0.15, 3))
        cloud = Reading(step, rng.uniform(-8, 8, (50, 3)))
        own, onnx = (
            Pilot(each.description, each.networks, each.goals).decide(step, pose, velocity, {"all": cloud})
            for each in pilots
        )
        assert (own.stop, onnx.stop) == ("", "")
        assert (onnx.action, onnx.propeller_n, onnx.rudder_rad) == (
            own.action,
            own.propeller_n,
            own.rudder_rad,
        )
        assert onnx.q_values == pytest.approx(own.q_values, rel=1e-3, abs=1e-2)


def test_onnx_models_that_are_no_policy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    onnx = pytest.importorskip("onnx")
    file, flawed = tmp_path / "s1.onnx", tmp_path / "flawed.onnx"
    export_files([Path("s1")], file, None)
    plain, fewer, unnamed = (onnx.load(str(file)) for _ in range(3))
    del plain.metadata_props[:]
    (description,) = (each for each in fewer.metadata_props if each.key == "description")
    facts = json.loads(description.value)
    description.value = json.dumps({**facts, "observation": facts["observation"][1:]})
    del unnamed.graph.output[:1]
    contents = [each.SerializeToString() for each in (plain, fewer, unnamed)]
    for content in (b"", b"text", file.read_bytes()[:-1000], *contents):
        flawed.write_bytes(content)
        with pytest.raises(DockctlError, check=lambda error: error.code == "not_readable"):
            Pilot.load(flawed)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(DockctlError, check=lambda error: error.code == "unavailable"):
        Pilot.load(file)


def test_an_intermediate_pose_needs_a_final_one(s3_pilot: Path) -> None:
    with pytest.raises(DockctlError) as caught:
        Pilot.load(s3_pilot, intermediate=INTERMEDIATE)
    assert caught.value.code == "missing_key"
