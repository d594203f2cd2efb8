"""The hull of the own boat as a solid, for collisions and drawings."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from dockctl.scenarios.vessel import Hull
from dockctl.sim.harbor.solids import loft

Floats = NDArray[np.float64]

BOW_SHARE = 0.35
"""Fraction of the length over which the bow narrows."""
BOW_BREADTHS = ((0.0, 1.0), (0.35, 0.9), (0.65, 0.66), (0.88, 0.32), (1.0, 0.06))
"""Half-breadths along the bow: (fraction of the distance to the stem, fraction of half the beam)."""


def hull_outline(hull: Hull) -> Floats:
    """Return the convex (k, 2) outline of the hull from above, in the body frame, counter-clockwise [m]."""
    stern, shoulder = -hull.length_m / 2, hull.length_m * (0.5 - BOW_SHARE)
    bow = [(shoulder + s * BOW_SHARE * hull.length_m, b * hull.beam_m / 2) for s, b in BOW_BREADTHS]
    port = [*reversed(bow), (stern, hull.beam_m / 2)]
    starboard = [(x, -y) for x, y in reversed(port)]
    return np.array(port + starboard)


def hull_mesh(hull: Hull) -> trimesh.Trimesh:
    """Return the convex, closed hull in the body frame: water at z = 0, keel at -draft [m]."""
    outline = hull_outline(hull)
    return loft([np.insert(outline, 2, z, axis=1) for z in (-hull.draft_m, hull.freeboard_m)])
