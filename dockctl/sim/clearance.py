"""The least distance that a boat keeps from the harbor along its way."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from dockctl.geometry import wrap
from dockctl.scenarios.vessel import Hull
from dockctl.sim.hull import hull_mesh
from dockctl.sim.status import Floats


def hull_reach_m(hull: Hull) -> float:
    """Greatest horizontal distance of a point of the hull from the boat's origin [m]."""
    return float(np.hypot(*hull_mesh(hull).vertices[:, :2].T).max())


def least_clearance(eta: Floats, measure: Callable[[Floats], Floats], reach_m: float) -> float:
    """Return the minimum of `measure` over the poses of a way, asking for few of them.

    No point of the hull moves farther than the boat's centre plus its turn times `reach_m`, so the clearance
    cannot change faster either: a stretch that cannot go below the least one found so far is left out.

    Args:
        eta: (k, 3) successive poses, x, y [m] and heading [rad]; k >= 1.
        measure: clearance of poses, (m, 3) -> (m,) [m].
        reach_m: greatest distance of a point of the hull from the boat's origin [m].
    """

    @cache
    def at(row: int) -> float:
        return float(measure(eta[row : row + 1])[0])

    moves = np.hypot(*np.diff(eta[:, :2], axis=0).T) + reach_m * np.abs(wrap(np.diff(eta[:, 2])))
    moved = np.concatenate([[0.0], np.cumsum(moves)])
    least = min(at(0), at(len(eta) - 1))
    stretches = [(0, len(eta) - 1)]
    while stretches:
        first, last = stretches.pop()
        bound = (at(first) + at(last) - (moved[last] - moved[first])) / 2
        if last - first > 1 and bound < least:
            middle = (first + last) // 2
            least = min(least, at(middle))
            stretches += [(first, middle), (middle, last)]
    return least
