"""How many triangles a mesh file declares, determined before a reader allocates them.

Mesh readers trust the file: one of 1 kB may declare billions of values, or instance a mesh in thousands
of places.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable, Iterator
from itertools import chain
from typing import Any

from pydantic import BaseModel, NonNegativeInt

MAX_FILE_BYTES = 100_000_000
MAX_TRIANGLES = 1_000_000
"""Measured: up to 1.6 GB for a harbor of connected surfaces and its collision checker."""
MAX_GLB_HEADER_BYTES = 10_000_000
MAX_GLB_BYTES = 4 * MAX_FILE_BYTES
"""Maximum total size of all views and accessors of a GLB file; they may overlap."""
MAX_GLB_PRIMITIVES = 100_000
"""Maximum number of primitives in all instances; each takes 12 kB."""
COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}
TRIANGLES, STRIP = 4, 5


def declared_triangles(data: bytes, suffix: str) -> int:
    """Return an upper bound on the number of triangles that a reader creates from a mesh file's content.

    Raises:
        ValueError: its header is damaged, declares more than the file can hold, or refers to other files.
    """
    return {".glb": _glb, ".obj": _obj, ".ply": _ply, ".stl": _stl}[suffix](data)


def _obj(data: bytes) -> int:
    """Count the triangles of all polygons."""
    faces = re.findall(rb"^f.*", data.replace(b"\\\n", b""), re.MULTILINE)
    return sum(max(len(face.split()) - 3, 1) for face in faces)


def _stl(data: bytes) -> int:
    """Count by the size of a binary file, or the coordinates of a text file."""
    if len(data) >= 84 and len(data) == 84 + 50 * struct.unpack_from("<I", data, 80)[0]:
        return (len(data) - 84) // 50
    return sum(len(line.split()) for line in re.findall(rb"vertex(.*)", data.lower())) // 9


def _ply(data: bytes) -> int:
    """Return the number of faces in the header; a text file must not have many more lines than declared."""
    header, end, content = data.partition(b"end_header")
    elements = re.findall(rb"^\s*element\s+(\S+)\s+(\d{1,18})\s*$", header, re.MULTILINE)
    if not end or not elements:
        raise ValueError("it has no PLY header")
    counts = [int(count) for _, count in elements]
    if sum(counts) > len(content):
        raise ValueError(f"its header declares {sum(counts):,} elements, more than the file can hold")
    breaks = sum(content.count(bytes([code])) for code in b"\n\r\v\f\x1c\x1d\x1e\x85\xa8\xa9")
    if b"ascii" in header and breaks > 2 * sum(counts) + 1000:
        raise ValueError(f"it has {breaks:,} lines, but its header declares {sum(counts):,} elements")
    return max(int(count) // (3 if name == b"vertex" else 1) for name, count in elements)


class _Extended(BaseModel):
    extensions: dict[str, Any] = {}


class _View(_Extended):
    byteLength: NonNegativeInt


class _Accessor(BaseModel):
    count: NonNegativeInt
    type: str

    @property
    def values(self) -> int:
        return self.count * COMPONENTS[self.type]


class _Primitive(_Extended):
    attributes: dict[str, NonNegativeInt]
    indices: NonNegativeInt | None = None
    mode: NonNegativeInt = TRIANGLES


class _Mesh(BaseModel):
    primitives: list[_Primitive]


class _Node(BaseModel):
    mesh: NonNegativeInt | None = None
    children: list[NonNegativeInt] = []


class _Scene(BaseModel):
    nodes: list[NonNegativeInt] = []


class _Header(BaseModel):
    """The parts of a glTF file that determine its size."""

    buffers: list[dict[str, Any]] = []
    bufferViews: list[_View] = []
    accessors: list[_Accessor] = []
    meshes: list[_Mesh] = []
    nodes: list[_Node] = []
    scenes: list[_Scene] = []

    def triangles(self, mesh: _Mesh) -> int:
        """Return the number of triangles of a mesh, or a third of its vertices if that is more."""
        total = 0
        for primitive in mesh.primitives:
            vertices = self.accessors[primitive.attributes["POSITION"]].count
            corners = vertices if primitive.indices is None else self.accessors[primitive.indices].count
            total += max(vertices // 3, corners if primitive.mode == STRIP else corners // 3)
        return total

    def instances(self) -> Iterator[int]:
        """Yield the index of each mesh once for every node that places it."""
        lists = [*(node.children for node in self.nodes), *(scene.nodes for scene in self.scenes)]
        for child in chain.from_iterable(lists):
            if (mesh := self.nodes[child].mesh) is not None:
                yield mesh

    def total(self, size: Callable[[_Mesh], int]) -> int:
        """Return the sum of the sizes of all meshes, or of all instances if that is more."""
        sizes = [size(mesh) for mesh in self.meshes]
        return max(sum(sizes), sum(sizes[mesh] for mesh in self.instances()))


def _glb(data: bytes) -> int:
    """Count the triangles of all instances of all meshes."""
    if len(data) < 20 or data[:4] != b"glTF":
        raise ValueError("it has no GLB header")
    size = struct.unpack_from("<I", data, 12)[0]
    if size > MAX_GLB_HEADER_BYTES:
        raise ValueError(
            f"its JSON header has {size / 1e6:,.0f} MB, at most {MAX_GLB_HEADER_BYTES / 1e6:.0f}"
        )
    try:
        header = _Header.model_validate(json.loads(data[20 : 20 + size]))
        values = sum(accessor.values for accessor in header.accessors)
        triangles = header.total(header.triangles)
        primitives = header.total(lambda mesh: len(mesh.primitives))
    except (ValueError, LookupError, RecursionError):
        raise ValueError("its JSON header is not valid") from None
    for buffer in header.buffers:
        if not str(buffer.get("uri", "data:")).startswith("data:"):
            raise ValueError(f"its data is in another file, {buffer['uri']!r}; embed it")
    if primitives > MAX_GLB_PRIMITIVES:
        raise ValueError(f"it has {primitives:,} primitives in all instances, at most {MAX_GLB_PRIMITIVES:,}")
    own = chain.from_iterable(mesh.primitives for mesh in header.meshes)
    extended: Iterator[_Extended] = chain(header.bufferViews, own)
    if any("compression" in name for part in extended for name in part.extensions):
        raise ValueError("it is compressed; export it without compression")
    needed = 4 * values + sum(view.byteLength for view in header.bufferViews)
    if needed > MAX_GLB_BYTES:
        raise ValueError(f"it declares {needed / 1e9:,.1f} GB of data, at most {MAX_GLB_BYTES / 1e9:g}")
    return triangles
