"""Mesh files: the user's obstacles, and the models of moored vessels in ``vessels/``.

Obstacles are GLB, OBJ, STL or PLY files. A vessel model is an OBJ file; it can be edited or replaced (in
Blender: import and export with Z up), and a new file is a new model. Its first line is a comment with the
class of the vessel. Every object is one closed solid, named ``<number>-<kind>``: drawings paint the solids in
the order of their numbers, and the kinds are those of `dockctl.drawing.palette.SOLIDS`.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cache, cached_property
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dockctl.errors import Code, DockctlError, InputError, Problem
from dockctl.reading import read_limited
from dockctl.scenarios.base import MAX_COORDINATE_M
from dockctl.scenarios.harbor import VESSEL_MODELS, MeshFile, is_model_file
from dockctl.sim.harbor.mesh_size import MAX_FILE_BYTES, MAX_TRIANGLES, declared_triangles
from dockctl.sim.harbor.solids import Mesh, Solid, joined

if TYPE_CHECKING:
    import trimesh

logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # its readers log tracebacks of damaged files

SUFFIXES = (".glb", ".obj", ".stl", ".ply")
MAX_BODIES = 100_000
"""Maximum number of connected bodies in a mesh file; each takes 5 kB."""
MAX_MODEL_BYTES = 10_000_000
"""Maximum file size of a vessel model; the packaged ones have up to 0.2 MB."""


def load_bodies(file: MeshFile, base_dir: Path, field: str) -> list[Mesh]:
    """Read a mesh file into the world frame, z up [m], and split it into connected bodies.

    No other file is opened: materials and textures are not used.

    Raises:
        InputError: the file is missing, unreadable, empty, damaged or too large, as a problem of `field`.
    """
    import trimesh  # slow to import, and needed for nothing else

    path = base_dir / file.path
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise _error(path, field, f"unknown type of mesh file; expected {', '.join(SUFFIXES)}")
    data = _read(path, MAX_FILE_BYTES, field)
    with np.errstate(all="ignore"):  # values that are too large are rejected below
        mesh = _mesh(data, suffix, path, field)
        _check_mesh(mesh, path, field)
        vertices = np.asarray(mesh.vertices, dtype=np.float64)
        if file.up == "y":
            vertices = np.stack((vertices[:, 0], -vertices[:, 2], vertices[:, 1]), axis=1)
        merged = trimesh.Trimesh(vertices * file.scale + file.shift_m, mesh.faces, process=False)
    if not np.abs(merged.vertices).max() <= MAX_COORDINATE_M:
        message = f"extends beyond {MAX_COORDINATE_M:,.0f} m after scale and shift_m"
        raise _error(path, field, message, "out_of_range")
    merged.merge_vertices(merge_tex=True, merge_norm=True)
    return _bodies(merged, path, field)


def _mesh(data: bytes, suffix: str, path: Path, field: str) -> trimesh.Trimesh:
    import trimesh

    try:
        _require_few(declared_triangles(data, suffix), path, field)
        # A stream instead of a path: the reader cannot open files that this one refers to.
        return trimesh.load_mesh(BytesIO(data), suffix[1:], process=False, skip_materials=True)
    except InputError:
        raise
    except Exception as error:  # the readers of trimesh raise many types
        reason = f" ({error})" if isinstance(error, ValueError) else ""  # other messages do not help the user
        raise _error(path, field, f"damaged, or not a {suffix[1:].upper()} file{reason}") from error


def _read(path: Path, max_bytes: int, field: str) -> bytes:
    try:
        data = read_limited(path, max_bytes)
    except DockctlError as error:
        raise _error(path, field, error.message, error.code) from None
    if not data:
        raise _error(path, field, "the file is empty")
    return data


def _require_few(triangles: int, path: Path, field: str) -> None:
    if triangles > MAX_TRIANGLES:
        message = f"has {triangles:,} triangles, at most {MAX_TRIANGLES:,} fit into memory; simplify it"
        raise _error(path, field, message, "out_of_range")


def _bodies(mesh: trimesh.Trimesh, path: Path, field: str) -> list[Mesh]:
    """Split a mesh into sets of faces that are connected by shared vertices."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    faces = np.asarray(mesh.faces)
    edges = faces[:, [0, 1, 1, 2]].reshape(-1, 2)
    size = len(mesh.vertices)
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(size, size))
    _, label = connected_components(graph, directed=False)
    body = label[faces[:, 0]]
    order = np.argsort(body, kind="stable")
    ends = np.flatnonzero(np.diff(body[order])) + 1
    if len(ends) >= MAX_BODIES:
        message = f"has {len(ends) + 1:,} bodies that share no vertices, at most {MAX_BODIES:,}; merge them"
        raise _error(path, field, message, "out_of_range")
    groups = np.split(faces[order], ends)
    corners = [np.unique(group, return_inverse=True) for group in groups]
    vertices = np.asarray(mesh.vertices)
    return [Mesh(vertices[used], index.reshape(-1, 3)) for used, index in corners]


def _check_mesh(mesh: trimesh.Trimesh, path: Path, field: str) -> None:
    if len(mesh.faces) == 0:
        raise _error(path, field, "contains no triangles")
    _require_few(len(mesh.faces), path, field)
    if mesh.vertices.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,):
        raise _error(path, field, "contains vertices without three coordinates, or polygons")
    if mesh.faces.min() < 0 or mesh.faces.max() >= len(mesh.vertices):
        raise _error(path, field, f"contains a triangle with a vertex beyond the last, {len(mesh.vertices)}")
    if not np.isfinite(mesh.vertices).all():
        bad = int((~np.isfinite(mesh.vertices)).any(axis=1).sum())
        raise _error(path, field, f"contains {bad} vertices (of {len(mesh.vertices)}) that are not finite")
    if not (mesh.area_faces > 0).any():
        raise _error(path, field, "contains only triangles with zero area")


@dataclass(frozen=True, eq=False)
class MooredModel:
    """A vessel in its own frame: stern at x = 0, bow along +x, waterline at z = 0 [m].

    Attributes:
        vessel_class: for example "sailing boat", for messages.
        solids: closed solids in painting order.
    """

    vessel_class: str
    solids: tuple[Solid, ...]

    @cached_property
    def mesh(self) -> Mesh:
        """All solids in one mesh."""
        return joined(self.solids)

    @property
    def beam_m(self) -> float:
        """Maximum breadth [m]."""
        return float(self.mesh.extents[1])


def version(path: Path) -> tuple[int, int] | None:
    """Return a key that changes when a file is rewritten, for caches of its content; None without a file."""
    try:
        status = path.stat()
    except OSError:  # reported where it is read
        return None
    return status.st_mtime_ns, status.st_size


def model_path(name: str) -> Path:
    """Return the file of the model `name`, which may be a path itself."""
    return Path(name) if is_model_file(name) else VESSEL_MODELS / f"{name}.obj"


def moored_model(name: str) -> MooredModel:
    """Return the model `name`, or that of the OBJ file `name`, from a cache.

    Raises:
        InputError: the file is missing or damaged.
    """
    path = model_path(name)
    return _model(path, version(path))


@cache
def _model(path: Path, version: tuple[int, int] | None) -> MooredModel:
    return read_model(path)


def read_model(path: Path) -> MooredModel:
    """Read a vessel from an OBJ file; the coordinates are the file's numbers as float64, shifted to x >= 0.

    Raises:
        InputError: the file cannot be read, a line is not valid, or there is no object with triangles.
    """
    try:
        lines = _read(path, MAX_MODEL_BYTES, "").decode().splitlines()
    except UnicodeDecodeError as error:
        raise _error(path, "", f"is not UTF-8 text: {error}") from None
    vertices: list[list[float]] = []
    objects: dict[str, list[list[int]]] = {}
    faces: list[list[int]] = []
    for number, line in enumerate(lines, start=1):
        keyword, *words = line.split() or ["#"]
        try:
            if keyword == "o":
                faces = objects[words[0]] = []
            elif keyword == "v":
                x, y, z = map(float, words[:3])
                if not all(abs(number) <= MAX_COORDINATE_M for number in (x, y, z)):
                    raise ValueError(line)
                vertices.append([x, y, z])
            elif keyword == "f":
                corners = [int(word.partition("/")[0]) - 1 for word in words]
                if len(corners) < 3 or min(corners) < 0 or max(corners) >= len(vertices):
                    raise ValueError(line)
                faces += [[corners[0], *pair] for pair in pairwise(corners[1:])]
        except (ValueError, IndexError):
            message = f"not a valid '{keyword}' line of an OBJ file: {line.strip()!r}"
            raise _error(path, "", message, line=number) from None
    if not objects or not all(objects.values()):
        message = "contains no objects" if not objects else "contains an object without faces"
        raise _error(path, "", message)
    points = np.array(vertices)
    solids = [_solid(name, points, np.array(objects[name])) for name in sorted(objects)]
    stern = min(solid.mesh.bounds[0, 0] for solid in solids)
    vessel_class = lines[0].removeprefix("#").strip() if lines[0].startswith("#") else "vessel"
    return MooredModel(vessel_class, tuple(solid.shifted((-stern, 0.0, 0.0)) for solid in solids))


def _solid(name: str, points: np.ndarray, faces: np.ndarray) -> Solid:
    """Return one object of a file; Blender appends a number to duplicate names: ``00-hull.001``."""
    used, index = np.unique(faces, return_inverse=True)
    mesh = Mesh(points[used], index.reshape(-1, 3))
    return Solid(name.partition("-")[2].partition(".")[0], mesh)


def _error(path: Path, field: str, message: str, code: Code = "not_readable", line: int = 0) -> InputError:
    return InputError([Problem(str(path), line, min(line, 1), field, message, code)])
