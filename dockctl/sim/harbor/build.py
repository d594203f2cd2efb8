"""The harbor as closed solids: the parts of a marina, and mesh files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dockctl.compute import shared
from dockctl.drawing.scene import Polygon, Scene
from dockctl.errors import InputError, Problem
from dockctl.geometry import Floats
from dockctl.scenarios.harbor import Generated, HarborSpec, Marina, is_model_file
from dockctl.scenarios.layouts import generate
from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.marina import Berth, harbor_problem, marina_berths, marina_parts
from dockctl.sim.harbor.mesh_files import load_bodies, model_path, moored_model, version
from dockctl.sim.harbor.mesh_size import MAX_TRIANGLES
from dockctl.sim.harbor.solids import Part, Solid, hull_outline, outlines


@dataclass(frozen=True, eq=False)
class Harbor:
    """All obstacles, which do not move.

    Attributes:
        triangles: (m, 3, 3) corners in the world frame [m], outward-facing.
        part_of_triangle: (m,) index into `parts`.
        basin: the water between the quays, ``(x_min, y_min, x_max, y_max)`` [m], if there are quays.
    """

    name: str
    parts: tuple[Part, ...]
    triangles: Floats
    part_of_triangle: NDArray[np.int64]
    berths: tuple[Berth, ...]
    basin: tuple[float, float, float, float] | None

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Bounds of the basin, or else of all solids, ``(x_min, y_min, x_max, y_max)`` [m]."""
        if self.basin is not None:
            return self.basin
        corners = self.triangles[:, :, :2].reshape(-1, 2)
        (x_min, y_min), (x_max, y_max) = corners.min(axis=0), corners.max(axis=0)
        return float(x_min), float(y_min), float(x_max), float(y_max)


def build_scene(harbor: Harbor, hull: Hull) -> Scene:
    """Return the plan view of the harbor and our boat, in painting order."""
    polygons = (
        Polygon(solid.kind, part.name, xy, height)
        for part in harbor.parts
        for solid in part.solids
        for xy, height in outlines(solid.mesh)
    )
    return Scene(harbor.name, tuple(polygons), hull_outline(hull), harbor.bounds)


def build_harbor(spec: HarborSpec, base_dir: Path) -> Harbor:
    """Return the harbor of `spec`, from a cache unless a file has changed; for generated layouts, the first.

    Args:
        spec: the harbor.
        base_dir: folder that paths of mesh files are relative to.

    Raises:
        InputError: lists all problems: mesh files, berths too narrow for the fleet, the size.
    """
    if isinstance(spec, Generated):
        spec = generate(spec, spec.seed)
    files = [base_dir / file.path for file in spec.meshes]
    if isinstance(spec, Marina):
        files += [model_path(name) for name in spec.fleet.models if is_model_file(name)]
    # Without mesh files the result does not depend on the folder.
    return _build(spec, base_dir if spec.meshes else Path(), tuple(map(version, files)))


def open_bodies(spec: HarborSpec, base_dir: Path) -> dict[str, int]:
    """Return the number of open bodies by the field of their mesh file, for the files that have some.

    Raises:
        DockctlError: a mesh file cannot be read.
    """
    parts = [part for part in build_harbor(spec, base_dir).parts if part.kind == "mesh"]
    solids = {f"harbor.meshes.{index}.path": part.solids for index, part in enumerate(parts)}
    if isinstance(spec, Marina):
        for index, name in enumerate(spec.fleet.models):
            solids[f"harbor.fleet.models.{index}"] = moored_model(name).solids
    opened = {field: sum(not s.mesh.is_watertight for s in found) for field, found in solids.items()}
    return {field: number for field, number in opened.items() if number}


@shared(lambda harbor: 3 * harbor.triangles.nbytes)  # the triangles, and the meshes of the parts
def _build(spec: HarborSpec, base_dir: Path, versions: tuple[tuple[int, int] | None, ...]) -> Harbor:
    basin = None
    berths: list[Berth] = []
    problems: list[Problem] = []
    if isinstance(spec, Marina):
        water = spec.basin
        basin = (water.x_min_m, water.y_min_m, water.x_max_m, water.y_max_m)
        berths = list(marina_berths(spec))
    parts: list[Part] = []
    triangles = 0
    for part in _parts(spec, berths, base_dir, problems):
        parts.append(part)
        triangles += sum(len(solid.mesh.faces) for solid in part.solids)
        if triangles > MAX_TRIANGLES:
            message = f"has more than {MAX_TRIANGLES:,} triangles; larger harbors may not fit into memory"
            raise InputError([*problems, harbor_problem(spec, "harbor", message, "out_of_range")])
    if problems:
        raise InputError(problems)
    return assemble(spec.name, parts, berths, basin)


def _parts(
    spec: HarborSpec, berths: Sequence[Berth], base_dir: Path, problems: list[Problem]
) -> Iterator[Part]:
    """Yield the parts of a harbor, and add the reasons for what is missing to `problems`."""
    if isinstance(spec, Marina):
        yield from marina_parts(spec, berths, problems)
    for index, file in enumerate(spec.meshes):
        try:
            bodies = load_bodies(file, base_dir, f"harbor.meshes.{index}.path")
        except InputError as error:
            problems += error.problems
        else:
            yield Part(Path(file.path).name, "mesh", tuple(Solid("mesh", body) for body in bodies))


def assemble(
    name: str,
    parts: Sequence[Part],
    berths: Sequence[Berth] = (),
    basin: tuple[float, float, float, float] | None = None,
) -> Harbor:
    """Return the harbor that consists of the parts."""
    pieces = [part.mesh.triangles for part in parts]
    triangles = np.concatenate(pieces).astype(np.float64)
    counts = [len(piece) for piece in pieces]
    return Harbor(
        name=name,
        parts=tuple(parts),
        triangles=triangles,
        part_of_triangle=np.repeat(np.arange(len(parts)), counts),
        berths=tuple(berths),
        basin=basin,
    )
