"""Mesh files of users: GLB, OBJ, STL and PLY."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from dockctl.errors import Code, InputError, Problem
from dockctl.scenarios.harbor import MeshFile

SUFFIXES = (".glb", ".obj", ".stl", ".ply")


def load_bodies(file: MeshFile, base_dir: Path, field: str) -> list[trimesh.Trimesh]:
    """Read a mesh file into the world frame, z up [m], and split it into connected bodies.

    Raises:
        InputError: the file is missing, unreadable, empty or damaged, as a problem of `field`.
    """
    path = base_dir / file.path
    _check_file(path, field)
    try:
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # the readers of trimesh raise many types
        reason = f" ({error})" if isinstance(error, ValueError) else ""  # others mean nothing to the user
        raise _error(path, field, f"damaged, or not a {path.suffix[1:].upper()} file{reason}") from error
    _check_mesh(mesh, path, field)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if file.up == "y":
        vertices = np.stack((vertices[:, 0], -vertices[:, 2], vertices[:, 1]), axis=1)
    merged = trimesh.Trimesh(vertices * file.scale + file.shift_m, mesh.faces, process=False)
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    return _bodies(merged)


def _bodies(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Split a mesh into sets of faces that are connected by shared vertices."""
    faces = np.asarray(mesh.faces)
    label = np.arange(len(mesh.vertices))
    while True:
        lowest = label.copy()
        np.minimum.at(lowest, faces, label[faces].min(axis=1, keepdims=True))
        lowest = lowest[lowest]  # a label is a vertex, which may have a lower label now
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


def _check_file(path: Path, field: str) -> None:
    if path.suffix.lower() not in SUFFIXES:
        raise _error(path, field, f"unknown type of mesh file; known are {', '.join(SUFFIXES)}")
    if not path.exists():
        raise _error(path, field, "mesh file not found", "not_found")
    if not path.is_file():
        raise _error(path, field, "a folder, not a mesh file")
    try:
        with path.open("rb") as stream:
            empty = not stream.read(1)
    except OSError as error:
        raise _error(path, field, f"cannot be opened: {error.strerror}") from None
    if empty:
        raise _error(path, field, "the file is empty")


def _check_mesh(mesh: trimesh.Trimesh, path: Path, field: str) -> None:
    if len(mesh.faces) == 0:
        raise _error(path, field, "contains no triangles")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise _error(path, field, f"contains a triangle with a vertex beyond the last, {len(mesh.vertices)}")
    if not np.isfinite(mesh.vertices).all():
        bad = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
        raise _error(path, field, f"contains {bad} vertices (of {len(mesh.vertices)}) that are not finite")
    if not (mesh.area_faces > 0).any():
        raise _error(path, field, "contains only triangles with zero area")


def _error(path: Path, field: str, message: str, code: Code = "not_readable") -> InputError:
    return InputError([Problem(str(path), 0, 0, field, message, code)])
