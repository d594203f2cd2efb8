"""Planar geometry that several packages share: angles, poses, outlines, sectors.

A pose is x, y [m] and heading [rad], counterclockwise from the x axis. The body frame has x forward and y to
port.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

MAX_SECTORS = 1024
"""Maximum number of sectors around a boat."""


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view of an array that cannot be written to."""
    view = array.view()
    view.flags.writeable = False
    return view


class DegreePose(Protocol):
    """A pose as in scenarios, with the heading in degrees."""

    @property
    def x_m(self) -> float: ...
    @property
    def y_m(self) -> float: ...
    @property
    def heading_deg(self) -> float: ...


def pose_array(pose: DegreePose) -> Floats:
    """Return x, y [m] and heading [rad], (3,)."""
    return np.array([pose.x_m, pose.y_m, math.radians(pose.heading_deg)])


def shown_heading(heading_deg: float) -> float:
    """Return a heading for display: rounded to two decimals, in 0 to 360 [°]."""
    return round(heading_deg, 2) % 360


def pose_label(x_m: float, y_m: float, heading_deg: float) -> str:
    """Return a pose as text: ``(20, −2, 160°)``, rounded to two decimals, with its `shown_heading`."""
    rounded = (round(x_m, 2), round(y_m, 2), shown_heading(heading_deg))
    x, y, heading = (f"{value + 0.0:g}".replace("-", "−") for value in rounded)
    return f"({x}, {y}, {heading}°)"


def wrap(angle: Floats) -> Floats:
    """Return the angle [rad] wrapped to (-pi, pi]; an angle in this range is returned unchanged."""
    turned = angle - 2 * np.pi * np.round(angle / (2 * np.pi))
    return np.where(turned <= -np.pi, np.pi, np.minimum(turned, np.pi))


def rotate(x: Floats, y: Floats, angle: float | Floats) -> tuple[Floats, Floats]:
    """Return the coordinates (n,) of points, rotated about the origin by `angle`, one or (n,) [rad]."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return cosine * x - sine * y, sine * x + cosine * y


def to_world(points: Floats, pose: Floats) -> Floats:
    """Transform points (..., 2 or 3) from the body frame to the world frame of a pose (3,) [m, m, rad]."""
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    world = np.array(points, float)
    world[..., :2] = world[..., :2] @ np.array([[cosine, sine], [-sine, cosine]]) + pose[:2]
    return world


def relocate_poses(poses: Floats, origin: Floats, to: Floats, mirrored: bool) -> Floats:
    """Move poses by the rigid motion that takes `origin` to `to`.

    Args:
        poses: (k, 3) x, y [m] and heading [rad].
        origin, to: (3,) poses.
        mirrored: first reflect the poses in the line along `origin`, port to starboard.

    Returns:
        (k, 3), headings in (-pi, pi].
    """
    forward, port = rotate(poses[:, 0] - origin[0], poses[:, 1] - origin[1], -origin[2])
    side = -1.0 if mirrored else 1.0
    x, y = rotate(forward, side * port, to[2])
    heading = wrap(to[2] + side * (poses[:, 2] - origin[2]))
    return np.column_stack([to[0] + x, to[1] + y, heading])


def sector_index(azimuth: Floats | float, sectors: int) -> Any:
    """Return the index of the LiDAR sector at an azimuth from -pi to pi in the body frame (thesis Fig. 3.9).

    The circle is divided into equal sectors from -pi to pi. The result has the shape of `azimuth`. The LiDAR
    scan compiles this function for scalars.
    """
    return np.int64(np.minimum((azimuth + np.pi) / (2 * np.pi) * sectors, sectors - 1))


def sector_edges_deg(sectors: int) -> Floats:
    """Return the azimuths of the edges of the sectors in order, (sectors + 1,) [°]."""
    return np.linspace(-180.0, 180.0, sectors + 1)


def nearest_in_sectors(points: Floats, sectors: int, range_m: float) -> Floats:
    """Return the horizontal distance of the nearest point in each sector, (sectors,) [m] (eqs. 3.7, 3.8).

    Args:
        points: (k, 2) or (k, 3) in the body frame [m].
        range_m: value of a sector without a nearer point [m].
    """
    x, y = points[:, 0], points[:, 1]
    nearest = np.full(sectors, range_m, float)
    np.minimum.at(nearest, sector_index(np.arctan2(y, x), sectors), np.sqrt(x * x + y * y))
    return nearest


def proximities(ranges_m: Floats) -> Floats:
    """Return the inverse [1/m] of ranges [m], in the same shape; ranges below 1 mm count as 1 mm."""
    return 1 / np.maximum(ranges_m, 1e-3)
