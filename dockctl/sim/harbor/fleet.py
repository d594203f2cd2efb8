"""Models of moored vessels, one OBJ file each in ``vessels/``.

A file can be edited or replaced (in Blender: import and export with Z up), and a new file is a new model. The
first line is a comment with the class of the vessel. Every object is one closed solid, named
``<number>-<kind>``: drawings paint the solids in the order of their numbers, and the kinds are those of
`dockctl.drawing.scene.KINDS`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from dockctl.errors import Code, InputError, Problem
from dockctl.scenarios.harbor import VESSEL_MODELS, is_model_file
from dockctl.sim.harbor.solids import Solid, joined


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
    def mesh(self) -> trimesh.Trimesh:
        """All solids in one mesh."""
        return joined(self.solids)

    @property
    def beam_m(self) -> float:
        """Greatest breadth [m]."""
        return float(self.mesh.extents[1])


@cache
def moored_model(name: str) -> MooredModel:
    """Return the model `name`, or that of the OBJ file `name`.

    Raises:
        InputError: the file is missing or damaged.
    """
    return read_model(Path(name) if is_model_file(name) else VESSEL_MODELS / f"{name}.obj")


def read_model(path: Path) -> MooredModel:
    """Read a vessel from an OBJ file; the coordinates are the file's numbers as float64, shifted to x >= 0.

    Raises:
        InputError: the file cannot be read, a line is not valid, or there is no object with triangles.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = f"cannot be read: {getattr(error, 'strerror', None) or error}"
        code: Code = "not_found" if isinstance(error, FileNotFoundError) else "not_readable"
        raise InputError([Problem(str(path), 0, 0, "", reason, code)]) from None
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
                if not math.isfinite(x + y + z):
                    raise ValueError(line)
                vertices.append([x, y, z])
            elif keyword == "f":
                corners = [int(word.partition("/")[0]) - 1 for word in words]
                if len(corners) < 3 or min(corners) < 0 or max(corners) >= len(vertices):
                    raise ValueError(line)
                faces += [[corners[0], *pair] for pair in pairwise(corners[1:])]
        except (ValueError, IndexError):
            message = f"not a valid '{keyword}' line of an OBJ file: {line.strip()!r}"
            raise InputError([Problem(str(path), number, 1, "", message, "not_readable")]) from None
    if not objects or not all(objects.values()):
        message = "contains no objects" if not objects else "contains an object without faces"
        raise InputError([Problem(str(path), 0, 0, "", message, "not_readable")])
    points = np.array(vertices)
    solids = [_solid(name, points, np.array(objects[name])) for name in sorted(objects)]
    stern = min(solid.mesh.bounds[0, 0] for solid in solids)
    vessel_class = lines[0].removeprefix("#").strip() if lines[0].startswith("#") else "vessel"
    return MooredModel(vessel_class, tuple(solid.shifted((-stern, 0.0, 0.0)) for solid in solids))


def _solid(name: str, points: np.ndarray, faces: np.ndarray) -> Solid:
    """Return one object of a file; Blender appends a number to names that occur twice: ``00-hull.001``."""
    used, index = np.unique(faces, return_inverse=True)
    mesh = trimesh.Trimesh(points[used], index.reshape(-1, 3), process=False)
    return Solid(name.partition("-")[2].partition(".")[0], mesh)
