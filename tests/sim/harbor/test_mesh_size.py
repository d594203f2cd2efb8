"""Mesh files that are hostile or too large are refused before they are read into memory."""

from __future__ import annotations

import builtins
import json
import os
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from dockctl.errors import InputError
from dockctl.scenarios.harbor import MeshFile
from dockctl.sim.harbor import mesh_files, mesh_size
from dockctl.sim.harbor.mesh_files import load_bodies, read_model
from dockctl.sim.harbor.mesh_size import declared_triangles
from tests.sim.meshes import peer

PEAK_BYTES = 5_000_000
"""Reading a hostile file may take this memory, and a multiple of its size."""
MANY = 200_000_000


def glb(header: dict[str, Any], binary: bytes = b"") -> bytes:
    """Return a GLB file of a JSON header and one binary chunk."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks


CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()


def triangle(**changes: Any) -> dict[str, Any]:
    """Return the header of a GLB file with one triangle, changed."""
    header = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }
    return {**header, **changes}


def accessor(**changes: Any) -> dict[str, Any]:
    (given,) = triangle()["accessors"]
    changed = {key: value for key, value in {**given, **changes}.items() if value is not None}
    return triangle(accessors=[changed])


def ply(vertices: int, faces: int, content: bytes) -> bytes:
    kinds = f"element vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
    lists = f"element face {faces}\nproperty list uchar int vertex_indices\n"
    return f"ply\nformat ascii 1.0\n{kinds}{lists}end_header\n".encode() + content


# Suffix and content; at most `FEW` triangles are allowed.
FEW = 1000
HOSTILE: dict[str, tuple[str, bytes]] = {
    "many values without data": (".glb", glb(accessor(bufferView=None, count=MANY))),
    "many values in little data": (".glb", glb(accessor(count=MANY), CORNERS)),
    "many overlapping accessors": (
        ".glb",
        glb(triangle(accessors=accessor()["accessors"] * 1000 + accessor(count=MANY // 2)["accessors"])),
    ),
    "many overlapping views": (
        ".glb",
        glb(triangle(bufferViews=[{"buffer": 0, "byteLength": 1_000_000}] * 500), CORNERS + bytes(1_000_000)),
    ),
    "a negative count": (".glb", glb(accessor(count=-5), CORNERS)),
    "a mesh in many places": (".glb", glb(triangle(scenes=[{"nodes": [0] * (FEW + 1)}]), CORNERS)),
    "a mesh of many primitives": (
        ".glb",
        glb(triangle(meshes=[{"primitives": triangle()["meshes"][0]["primitives"] * (FEW + 1)}]), CORNERS),
    ),
    "a node without a mesh": (".glb", glb(triangle(nodes=[{"children": [0], "mesh": 7}]), CORNERS)),
    "a deep header": (".glb", b"glTF" + struct.pack("<III4s", 2, 0, 200_000, b"JSON") + b"[" * 200_000),
    "a long header": (".glb", b"glTF" + struct.pack("<III4s", 2, 0, 4_000_000_000, b"JSON")),
    "another file": (".glb", glb(triangle(buffers=[{"uri": "pipe", "byteLength": 36}]))),
    "compressed data": (
        ".glb",
        glb(
            triangle(bufferViews=[{"byteLength": 36, "extensions": {"EXT_meshopt_compression": 1}}]), CORNERS
        ),
    ),
    "many faces": (".ply", ply(3, MANY, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")),
    "many vertices": (".ply", ply(MANY, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")),
    "many empty lines": (".ply", ply(3, 1, b"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n" + b"\n" * 100_000)),
    "no header": (".ply", b"ply\n"),
    "many triangles": (".stl", bytes(80) + struct.pack("<I", MANY)),
    "a long line": (".stl", b"solid x\nvertex" + b" 1" * 9 * (FEW + 1) + b"\nendsolid x\n"),
    "a large polygon": (".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3" * FEW),
    "a large polygon in many lines": (".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf" + b" 1 2 3 \\\n" * FEW),
    "many small polygons": (".obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n" + b"f 1 1 1\n" * (FEW + 1)),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_hostile_file_is_refused_before_it_takes_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, case: str
) -> None:
    monkeypatch.setattr(mesh_files, "MAX_TRIANGLES", FEW)
    suffix, content = HOSTILE[case]
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / f"x{suffix}").write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            load_bodies(MeshFile(path=f"x{suffix}"), tmp_path, "harbor.meshes.0.path")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    (problem,) = caught.value.problems
    assert (problem.field, problem.code) in {
        ("harbor.meshes.0.path", "not_readable"),
        ("harbor.meshes.0.path", "out_of_range"),
    }
    assert peak < PEAK_BYTES + 20 * len(content)


def test_the_smallest_glb_is_read(tmp_path: Path) -> None:
    """The hostile ones above differ from it in one place each."""
    (tmp_path / "x.glb").write_bytes(glb(triangle(), CORNERS))
    (body,) = load_bodies(MeshFile(path="x.glb"), tmp_path, "")
    assert peer(body).area == pytest.approx(0.5)


def test_no_other_file_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x.obj").write_text("mtllib secret.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd secret.png\n")
    (tmp_path / "y.glb").write_bytes(glb(triangle(images=[{"uri": "secret.png"}]), CORNERS))
    opened: list[str] = []
    for module, name in ((os, "open"), (builtins, "open")):
        real = getattr(module, name)

        def watched(path: Any, *rest: Any, real: Callable[..., Any] = real, **named: Any) -> Any:
            opened.append(str(path))
            return real(path, *rest, **named)

        monkeypatch.setattr(module, name, watched)
    for name in ("x.obj", "y.glb"):
        load_bodies(MeshFile(path=name), tmp_path, "")
    assert [path for path in opened if str(tmp_path) in path] == [
        str(tmp_path / "x.obj"),
        str(tmp_path / "y.glb"),
    ]


def surface(side: int) -> trimesh.Trimesh:
    return trimesh.creation.box((1, 1, 1)).subdivide_to_size(1 / side)


@pytest.mark.parametrize("kind", ["glb", "obj", "ply", "stl", "stl_ascii"])
def test_the_declared_number_bounds_the_real_one(kind: str) -> None:
    mesh = surface(6)
    data: Any = mesh.export(file_type=kind)
    content = data if isinstance(data, bytes) else data.encode()
    declared = declared_triangles(content, f".{kind[:3]}")
    assert len(mesh.faces) <= declared <= 1.01 * len(mesh.faces)


def test_a_glb_counts_every_place(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for index in range(5):
        scene.add_geometry(
            surface(2),
            "same",
            geom_name="same",
            transform=trimesh.transformations.translation_matrix([3 * index, 0, 0]),
        )
    data = scene.export(file_type="glb")
    (tmp_path / "x.glb").write_bytes(data)
    bodies = load_bodies(MeshFile(path="x.glb"), tmp_path, "")
    assert sum(len(body.faces) for body in bodies) <= declared_triangles(data, ".glb")


@pytest.mark.parametrize("where", ["meshes", "places"])
def test_primitives_of_a_glb_are_limited(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader needs far more memory for each than for its triangles."""
    monkeypatch.setattr(mesh_size, "MAX_GLB_PRIMITIVES", 50)

    def repeated(number: int) -> bytes:
        (mesh,) = triangle()["meshes"]
        several = {"meshes": {"meshes": [mesh] * number}, "places": {"scenes": [{"nodes": [0] * number}]}}
        return glb(triangle(**several[where]), CORNERS)

    assert declared_triangles(repeated(50), ".glb") == 50
    with pytest.raises(ValueError, match=r"\b51\b"):
        declared_triangles(repeated(51), ".glb")


@pytest.mark.parametrize("attribute", ["MAX_TRIANGLES", "MAX_BODIES", "MAX_FILE_BYTES"])
def test_limits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attribute: str) -> None:
    """A file at the limit is read; one beyond it is an error of its field."""
    boxes = [trimesh.creation.box((1, 1, 1)).apply_translation((3 * i, 0, 0)) for i in range(3)]
    file = tmp_path / "x.stl"
    trimesh.util.concatenate(boxes).export(file)
    limit = {"MAX_TRIANGLES": 36, "MAX_BODIES": 3, "MAX_FILE_BYTES": file.stat().st_size}[attribute]
    monkeypatch.setattr(mesh_files, attribute, limit)
    assert len(load_bodies(MeshFile(path="x.stl"), tmp_path, "here")) == 3
    monkeypatch.setattr(mesh_files, attribute, limit - 1)
    with pytest.raises(InputError) as caught:
        load_bodies(MeshFile(path="x.stl"), tmp_path, "here")
    assert [(p.field, p.code) for p in caught.value.problems] == [("here", "out_of_range")]


@pytest.mark.parametrize(
    ("scale", "shift", "valid"),
    [(9_000.0, 0.0, True), (11_000.0, 0.0, False), (1e12, 0.0, False), (9_000.0, 2_000.0, False)],
)
def test_a_mesh_is_within_ten_kilometers(tmp_path: Path, scale: float, shift: float, valid: bool) -> None:
    (tmp_path / "x.glb").write_bytes(glb(triangle(), CORNERS))
    read: Callable[[], Any] = lambda: load_bodies(  # noqa: E731
        MeshFile(path="x.glb", scale=scale, shift_m=(shift, 0, 0)), tmp_path, "here"
    )
    if valid:
        assert read()
    else:
        with pytest.raises(InputError, check=lambda error: error.code == "out_of_range"):
            read()


@pytest.mark.parametrize("name", ["pipe.obj", "folder.obj", "large.obj", "text.obj", "/dev/zero"])
def test_the_model_of_a_vessel_is_a_small_regular_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(mesh_files, "MAX_MODEL_BYTES", 1000)
    os.mkfifo(tmp_path / "pipe.obj")
    (tmp_path / "folder.obj").mkdir()
    (tmp_path / "large.obj").write_bytes(b"v 0 0 0\n" * 126)
    (tmp_path / "text.obj").write_bytes(b"\xff")
    with pytest.raises(InputError) as caught:
        read_model(tmp_path / name)
    assert caught.value.code in {"not_readable", "out_of_range"}
