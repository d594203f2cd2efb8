"""The twelve models of moored vessels, of our own drawing, in the classes of the thesis' appendix A."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import trimesh
from numpy.typing import NDArray

from dockctl.sim.boatyard import (
    CHINE,
    FLAT,
    House,
    Lines,
    Well,
    bar,
    block,
    fenders,
    hull,
    lifelines,
    outboard,
    pair,
    pulpit,
    rig,
)
from dockctl.sim.solids import Solid, rounded

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class VesselModel:
    """A vessel in its own frame: stern at x = 0, bow along +x, water at z = 0 [m].

    Attributes:
        noun: what a message calls it, such as "sailing boat".
        solids: closed pieces in the order in which a drawing from above paints them.
    """

    name: str
    noun: str
    solids: tuple[Solid, ...]

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        return trimesh.util.concatenate([solid.mesh for solid in self.solids])

    @property
    def length(self) -> float:
        return float(self.mesh.extents[0])

    @property
    def beam(self) -> float:
        return float(self.mesh.extents[1])

    @property
    def height(self) -> float:
        return float(self.mesh.bounds[1, 2])


@lru_cache(maxsize=None)
def vessel_model(name: str) -> VesselModel:
    """Build a model of the fleet by its name in `MODELS`."""
    noun, build = MODELS[name]
    solids = build()
    stern = min(solid.mesh.bounds[0, 0] for solid in solids)
    moved = [
        Solid(s.kind, trimesh.Trimesh(s.mesh.vertices - (stern, 0, 0), s.mesh.faces, process=False)) for s in solids
    ]
    return VesselModel(name, noun, tuple(moved))


def sailing(lines: Lines, mast: float, top: float, boom: float, cabin: float, well: Well) -> list[Solid]:
    """A keelboat: cockpit aft, coachroof, one mast."""
    house = House(well.x1 + 0.1, mast + cabin, 0.3 * lines.beam, 0.16 * lines.beam, float(lines.deck(mast)) - 0.06,
                  float(lines.deck(mast)) + 0.38, rake_fore=0.5, tumble=0.1, corners=4)  # fmt: skip
    return [
        hull(lines, well),
        Solid("deck", lines.sheet(well.x1 + 0.05, lines.length - 0.15, 0.1)),
        Solid("cockpit", lines.sheet(well.x0 + 0.06, well.x1 - 0.06, well.margin + 0.12, well.sole + 0.04)),
        *house.all(0.35, 0.8, 0.0),
        *pulpit(lines, lines.length - 1.3),
        *rig(lines, mast, top, boom, float(lines.deck(mast))),
    ]


def placeholder_open() -> list[Solid]:
    lines = Lines(5.4, 2.0, 0.3, (0.6, 0.6, 0.9), CHINE)
    well = Well(0.4, 3.6, 0.2)
    return [hull(lines, well), Solid("cockpit", lines.sheet(0.5, 3.5, 0.3, 0.24)), *outboard(-0.02, 0.5)]


def placeholder_sail() -> list[Solid]:
    lines = Lines(8.2, 2.7, 0.5, (0.9, 0.85, 1.1))
    return sailing(lines, 4.6, 11.0, 3.2, 1.4, Well(0.5, 2.6, 0.4, 0.35))


def placeholder_motor() -> list[Solid]:
    lines = Lines(8.6, 2.9, 0.5, (0.9, 1.0, 1.4), CHINE, fullness=2.8)
    house = House(2.6, 6.2, 1.1, 0.8, 0.9, 2.5, rake_fore=0.9)
    return [hull(lines, Well(0.5, 2.4, 0.5, 0.2)), Solid("deck", lines.sheet(2.5, 8.3, 0.12)), *house.all()]


MODELS: dict[str, tuple[str, Callable[[], list[Solid]]]] = {
    "skiff": ("open boat", placeholder_open),
    "console": ("open boat", placeholder_open),
    "cuddy": ("open boat", placeholder_open),
    "dinghy": ("sailing boat", placeholder_sail),
    "daysailer": ("sailing boat", placeholder_sail),
    "sloop": ("sailing boat", placeholder_sail),
    "cruiser": ("sailing boat", placeholder_sail),
    "sedan": ("motor yacht", placeholder_motor),
    "express": ("motor yacht", placeholder_motor),
    "flybridge": ("motor yacht", placeholder_motor),
    "inflatable": ("inflatable", placeholder_open),
    "catamaran": ("catamaran", placeholder_sail),
}
