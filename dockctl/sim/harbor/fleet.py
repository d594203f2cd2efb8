"""The twelve models of moored vessels, of our own drawing, in the classes of the thesis' appendix A."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import trimesh

from dockctl.sim.harbor.motorboats import console, cuddy, express, flybridge, inflatable, sedan, skiff
from dockctl.sim.harbor.sailboats import catamaran, cruiser, daysailer, dinghy, sloop
from dockctl.sim.harbor.solids import Solid, together

MODELS: dict[str, tuple[str, Callable[[], list[Solid]]]] = {
    "skiff": ("open boat", skiff),
    "console": ("open boat", console),
    "cuddy": ("open boat", cuddy),
    "dinghy": ("sailing boat", dinghy),
    "daysailer": ("sailing boat", daysailer),
    "sloop": ("sailing boat", sloop),
    "cruiser": ("sailing boat", cruiser),
    "sedan": ("motor yacht", sedan),
    "express": ("motor yacht", express),
    "flybridge": ("motor yacht", flybridge),
    "inflatable": ("inflatable boat", inflatable),
    "catamaran": ("catamaran", catamaran),
}
"""Name to (what a message calls it, recipe)."""


@dataclass(frozen=True, eq=False)
class MooredModel:
    """A vessel in its own frame: aftmost point at x = 0, bow along +x, water at z = 0 [m].

    `solids` are its closed pieces, in the order in which a drawing from above paints them.
    """

    name: str
    noun: str
    solids: tuple[Solid, ...]

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """All the solids in one mesh."""
        return together(self.solids)

    @property
    def beam(self) -> float:
        return float(self.mesh.extents[1])


@cache
def moored_model(name: str) -> MooredModel:
    """Build the model called `name`, a key of `MODELS`."""
    noun, build = MODELS[name]
    solids = build()
    stern = min(solid.mesh.bounds[0, 0] for solid in solids)
    return MooredModel(name, noun, tuple(solid.shifted((-stern, 0.0, 0.0)) for solid in solids))
