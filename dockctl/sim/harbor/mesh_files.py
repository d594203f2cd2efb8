"""Reading meshes that users bring: GLB, OBJ, STL and PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from dockctl.errors import InputError, Problem
from dockctl.scenarios.harbor import MeshFile

SUFFIXES = (".glb", ".obj", ".stl", ".ply")


def load_bodies(file: MeshFile, base_dir: Path, field: str) -> list[trimesh.Trimesh]:
    """Read a mesh file into the world frame, z up [m], and take it apart into connected bodies.

    Raises:
        InputError: the file is missing, unreadable, empty or broken; `field` says where it is named.
    """
    path = base_dir / file.path
    if flaw := _flaw_of_file(path):
        raise _error(path, field, flaw)
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # the readers of trimesh raise whatever their parsing meets
        reason = (
            f" ({error})" if isinstance(error, ValueError) else ""
        )  # others speak of the reader's own trouble
        raise _error(path, field, f"is damaged or is no {path.suffix[1:].upper()} file{reason}") from error
    if flaw := _flaw_of_mesh(mesh):
        raise _error(path, field, flaw)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if file.up == "y":
        vertices = np.stack((vertices[:, 0], -vertices[:, 2], vertices[:, 1]), axis=1)
    merged = trimesh.Trimesh(vertices * file.scale + file.shift_m, mesh.faces, process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    return _bodies(merged)


def _bodies(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Split a mesh where its faces share no vertices."""
    faces = np.asarray(mesh.faces)
    label = np.arange(len(mesh.vertices))
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, faces, label[faces].min(axis=1, keepdims=True))
        lowest = lowest[lowest]  # a label is a vertex, which may have found a lower one
        if np.array_equal(lowest, label):
            break
        label = lowest
    body = label[faces[:, 0]]
    order = np.argsort(body, kind="stable")
    groups = np.split(faces[order], np.flatnonzero(np.diff(body[order])) + 1)
    corners = [np.unique(group, return_inverse=True) for group in groups]
    return [
        trimesh.Trimesh(mesh.vertices[used], index.reshape(-1, 3), process=False) for used, index in corners
    ]


def _flaw_of_file(path: Path) -> str:
    if path.suffix.lower() not in SUFFIXES:
        return f"is not a mesh file that we read; allowed are {', '.join(SUFFIXES)}"
    if not path.exists():
        return "mesh file not found"
    if not path.is_file():
        return "is a directory, not a mesh file"
    try:
        with path.open("rb") as stream:
            return "" if stream.read(1) else "is an empty file"
    except OSError as error:
        return f"cannot be opened: {error.strerror}"


def _flaw_of_mesh(mesh: trimesh.Trimesh) -> str:
    if len(mesh.faces) == 0:
        return "holds no triangles"
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        return f"has a triangle with a corner that does not exist (there are {len(mesh.vertices)})"
    if not np.isfinite(mesh.vertices).all():
        bad = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
        return f"has {bad} of {len(mesh.vertices)} corners that are not finite numbers"
    if not (mesh.area_faces > 0).any():
        return "has only triangles without area"
    return ""


def _error(path: Path, field: str, flaw: str) -> InputError:
    return InputError([Problem(str(path), 0, 0, field, flaw)])
