"""Worlds without meshes: open water or a wall, and a LiDAR given by a formula."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dockctl.drawing.scene import Scene
from dockctl.geometry import Floats
from dockctl.sim.world import World


class Wall:
    """An obstacle that fills the world east of `x_m`; a boat is a point."""

    def __init__(self, x_m: float) -> None:
        self.x_m = x_m

    def near(self, eta: Floats, within_m: float) -> NDArray[np.bool_]:
        return eta[:, 0] + within_m > self.x_m

    def blocked(self, eta: Floats) -> NDArray[np.bool_]:
        return eta[:, 0] > self.x_m

    def unreachable(self, eta: Floats, goal: Floats) -> NDArray[np.bool_]:
        return self.blocked(eta)

    def collided_part(self, eta: Floats) -> str | None:
        return "wall" if eta[0] > self.x_m else None

    def clearance(self, eta: Floats) -> Floats:
        return self.approximate_clearance(eta)

    def approximate_clearance(self, eta: Floats) -> Floats:
        return np.maximum(self.x_m - eta[..., 0], 0.0)

    def clearance_below(self, eta: Floats, limit_m: float) -> Floats:
        return np.minimum(self.clearance(eta), limit_m)


class Rings:
    """Ranges that depend only on the pose; counts the scanned boats."""

    def __init__(self, sectors: int = 8) -> None:
        self.sectors, self.scanned, self.table_bytes = sectors, 0, 0

    def points(self, pose: Floats, every: int = 1) -> Floats:
        return np.empty((0, 3))

    def sector_ranges(self, eta: Floats) -> Floats:
        self.scanned += len(eta)
        return 30.0 + eta[:, :1] / 2 + np.arange(self.sectors) * np.abs(eta[:, 2:3])


def walled(x_m: float = np.inf) -> World:
    """Open water up to a wall at `x_m`."""
    return World(Wall(x_m), Rings(), water)


def water() -> Scene:
    return Scene("water", (), np.zeros((4, 2)), (0.0, 0.0, 50.0, 50.0))
