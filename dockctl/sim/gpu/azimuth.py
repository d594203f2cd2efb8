"""Sectors of returns, as the CPU assigns them.

Rays run along the edges of sectors, and the arctangents of GPU and CPU differ in the last bits, so that a
return there would be assigned to one sector on the CPU and to its neighbor on the GPU. Near an edge, the
azimuth is therefore computed from the edge, with twice the precision, and rounded once.
"""

from __future__ import annotations

import math

import numpy as np

from dockctl.compute import compiled
from dockctl.geometry import Floats
from dockctl.sim.lidar.shell_table import sector_at

NEAR = 1e-14
"""Azimuth difference [rad] from an edge: many times the error of an arctangent."""
SPLIT = 2.0**27 + 1
"""Splits a double into two halves with products that are exact (Dekker 1971)."""
PI = np.longdouble("3.14159265358979323846264338327950288")


def edges_of(sectors: int) -> Floats:
    """Return azimuth, cosine and sine of the edges from -pi to pi and their remainders, (sectors + 1, 6)."""
    azimuth = PI * (2 * np.arange(sectors + 1, dtype=np.longdouble) / sectors - 1)
    exact = np.stack([azimuth, np.cos(azimuth), np.sin(azimuth)], axis=1)
    rounded = exact.astype(float)
    return np.stack([rounded, (exact - rounded).astype(float)], axis=2).reshape(sectors + 1, 6)


@compiled()
def sector_of(x: float, y: float, edges: Floats) -> int:
    """Return the sector of a point [m] in the body frame."""
    return int(sector_at(azimuth_of(x, y, edges), len(edges) - 1))


@compiled()
def azimuth_of(x: float, y: float, edges: Floats) -> float:
    """Return atan2(y, x) [rad], correctly rounded near an edge."""
    azimuth = math.atan2(y, x)
    nearest = int((azimuth + math.pi) / (2 * math.pi) * (len(edges) - 1) + 0.5)
    edge, remainder, cosine, cosine_remainder, sine, sine_remainder = edges[nearest]
    if abs(azimuth - edge) > NEAR:
        return azimuth
    (a, a_remainder), (b, b_remainder) = product(y, cosine), product(x, sine)
    cross = (a - b) + ((a_remainder - b_remainder) + (y * cosine_remainder - x * sine_remainder))
    return float(edge + (remainder + cross / (x * cosine + y * sine)))


@compiled(inline="always")
def product(a: float, b: float) -> tuple[float, float]:
    """Return a product, rounded, and its rounding error."""
    rounded = a * b
    a_high, b_high = SPLIT * a - (SPLIT * a - a), SPLIT * b - (SPLIT * b - b)
    a_low, b_low = a - a_high, b - b_high
    return rounded, ((a_high * b_high - rounded) + a_high * b_low + a_low * b_high) + a_low * b_low
