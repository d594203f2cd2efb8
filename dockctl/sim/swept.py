"""First contact and minimum clearance of a hull along its path."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np

from dockctl.geometry import Floats
from dockctl.scenarios.vessel import Hull
from dockctl.sim.collision import SLACK_M, Obstacles

CONTACT_RESOLUTION_M = 0.002
"""Motion of the hull between the poses at which contact is tested."""


def first_contact(path: Floats, obstacles: Obstacles, hull: Hull) -> Floats | None:
    """Return where the hull first touches something on its way along a path, or None.

    A section of the path is skipped if nothing is near the hull at its middle, by its bounding box or else by
    the clearance; others are halved, down to `CONTACT_RESOLUTION_M` or, for small hulls, a tenth of the beam
    or length. A hull therefore cannot cross a surface, and only contact on a shorter path is missed.

    Args:
        path: (k, 3 + m) successive poses and any m other columns, linear in between; k >= 1.
        obstacles: what it can touch.
        hull: the hull.

    Returns:
        The row of `path`, interpolated, at the contact.
    """
    moved = _moved(path, hull.reach_m)
    resolution = min(CONTACT_RESOLUTION_M, 0.1 * hull.beam_m, 0.1 * hull.length_m)
    sections = [(0.0, float(moved[-1]))]
    while sections:
        begin, end = sections.pop()
        middle = (begin + end) / 2
        pose = np.array([[np.interp(middle, moved, column) for column in path.T[:3]]])
        reached = end - middle + SLACK_M
        if end - begin <= resolution:
            if obstacles.blocked(pose)[0]:
                return np.array([np.interp(middle, moved, column) for column in path.T])
        elif (
            obstacles.near(pose, rounded_up(end - middle))[0]
            and obstacles.clearance_below(pose, reached)[0] < reached
        ):
            sections += [(middle, end), (begin, middle)]
    return None


def rounded_up(distance_m: float) -> float:
    """Round up to one of four values per power of 2, because `near` caches a box for each value."""
    return float(2.0 ** (math.ceil(4 * math.log2(distance_m)) / 4)) if distance_m > 0 else 0.0


def least_clearance(eta: Floats, clearance: Callable[[Floats], Floats], reach_m: float) -> float:
    """Return the minimum clearance over the poses of a trajectory [m], computed at few of them.

    The clearance cannot change by more than the hull moves. A section of the trajectory is skipped if this
    bound shows that its clearance is not below the minimum found so far.

    Args:
        eta: (k, 3) successive poses, x, y [m] and heading [rad]; k >= 1.
        clearance: clearance of poses, (m, 3) to (m,) [m].
        reach_m: maximum distance of a point of the hull from the body origin [m].
    """

    @cache
    def at(row: int) -> float:
        return float(clearance(eta[row : row + 1])[0])

    moved = _moved(eta, reach_m)
    least = min(at(0), at(len(eta) - 1))
    sections = [(0, len(eta) - 1)]
    while sections:
        first, last = sections.pop()
        bound = (at(first) + at(last) - (moved[last] - moved[first])) / 2
        if last - first > 1 and bound < least:
            middle = (first + last) // 2
            least = min(least, at(middle))
            sections += [(first, middle), (middle, last)]
    return least


def _moved(path: Floats, reach_m: float) -> Floats:
    """Return an upper bound on the distance that any point of the hull moved up to each pose of a path [m].

    (k, 3 + m) to (k,). No point moves farther than the body origin plus the heading change times `reach_m`.
    """
    x, y, heading = np.diff(path[:, :3], axis=0).T
    return np.concatenate([[0.0], np.cumsum(np.hypot(x, y) + reach_m * np.abs(heading))])
