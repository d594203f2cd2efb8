"""The planar scanner against brute force, and against the closed form in a square basin."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from dockctl.scenarios.loader import load
from dockctl.sim.lidar.planar import PlanarScanner
from tests.sim.lidar.test_spinning_sensor import clutter

POSES = np.array([[0.0, 0.0, 0.0], [3.0, -4.0, 2.5], [-7.5, 6.0, -1.1]])
HALF_M = 10.0


def basin(height: float = 2.0) -> np.ndarray:
    """Four walls around a square of 20 m, from under the water to `height`."""
    walls = [
        trimesh.creation.box(bounds=[[HALF_M, -12, -1], [12, 12, height]]),
        trimesh.creation.box(bounds=[[-12, -12, -1], [-HALF_M, 12, height]]),
        trimesh.creation.box(bounds=[[-12, HALF_M, -1], [12, 12, height]]),
        trimesh.creation.box(bounds=[[-12, -12, -1], [12, -HALF_M, height]]),
    ]
    return np.array(trimesh.util.concatenate(walls).triangles)


def to_walls(x: float, y: float, angle: np.ndarray) -> np.ndarray:
    """Distance from a place in the basin to its walls in the directions `angle` [rad]."""
    with np.errstate(divide="ignore"):
        along_x = (np.copysign(HALF_M, np.cos(angle)) - x) / np.cos(angle)
        along_y = (np.copysign(HALF_M, np.sin(angle)) - y) / np.sin(angle)
    return np.minimum(along_x, along_y)


@pytest.mark.parametrize("pose", POSES)
def test_in_a_square_basin_the_ranges_have_a_closed_form(pose: np.ndarray) -> None:
    sensor = PlanarScanner(rays=101, sectors=7).build(basin())
    bearing = np.arange(101) * 2 * math.pi / 101
    expected = to_walls(pose[0], pose[1], bearing + pose[2])
    points = sensor.points(pose)
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx(expected)
    assert np.cos(np.arctan2(points[:, 1], points[:, 0]) - bearing) == pytest.approx(np.ones(101))
    azimuth = np.where(bearing > math.pi, bearing - 2 * math.pi, bearing)
    sector = np.floor((azimuth + math.pi) / (2 * math.pi) * 7)  # no ray lies on an edge between sectors
    nearest = [expected[sector == k].min() for k in range(7)]
    assert sensor.sector_ranges(pose[None])[0] == pytest.approx(nearest)


def test_brute_force_gives_the_same_points() -> None:
    """Each ray with each triangle as a linear system: origin + t d = a + u (b - a) + v (c - a)."""
    triangles, spec = clutter(3, solids=25, spread=12.0), PlanarScanner(rays=90, z_m=0.8, range_m=15.0)
    sensor = spec.build(triangles)
    for x, y, heading in POSES:
        expected = []
        for bearing in np.arange(90) * 2 * math.pi / 90:
            direction = np.array([math.cos(bearing + heading), math.sin(bearing + heading), 0.0])
            a, b, c = triangles.transpose(1, 0, 2)
            system = np.stack([np.broadcast_to(-direction, a.shape), b - a, c - a], axis=2)
            regular = np.abs(np.linalg.det(system)) > 1e-12
            offset = (np.array([x, y, 0.8]) - a)[regular]
            t, u, v = np.linalg.solve(system[regular], offset[:, :, None])[:, :, 0].T
            hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 15.0)
            if hit.any():
                distance = t[hit].min()
                expected.append([distance * math.cos(bearing), distance * math.sin(bearing), 0.8])
        points = sensor.points(np.array([x, y, heading]))
        assert len(points) > 10
        assert points == pytest.approx(np.array(expected))


@pytest.mark.parametrize("rays", [8, 16, 90, 720])
@pytest.mark.parametrize("sectors", [7, 8, 12])
def test_a_mirrored_harbor_gives_mirrored_ranges(rays: int, sectors: int) -> None:
    """Also where rays are on the edges of sectors. The clutter is not symmetric."""
    spec, triangles = PlanarScanner(rays=rays, sectors=sectors, z_m=0.8), clutter(3, solids=25, spread=12.0)
    ranges = spec.build(triangles).sector_ranges(POSES)
    mirrored = spec.build(triangles * [1, -1, 1]).sector_ranges(POSES * [1, -1, -1])
    assert mirrored == pytest.approx(ranges[:, ::-1])
    assert (ranges[:, ::-1] != pytest.approx(ranges)) and (ranges < spec.range_m).any()


def test_a_ray_on_an_edge_counts_in_both_sectors() -> None:
    """Of 8 rays, each is on an edge: a pile dead ahead is seen in both sectors beside the bow."""
    pile = trimesh.creation.box(bounds=[[5, -0.1, 0], [6, 0.1, 2]])
    sensor = PlanarScanner(rays=8, sectors=8, range_m=50).build(np.array(pile.triangles))
    assert sensor.sector_ranges(np.zeros((1, 3)))[0] == pytest.approx([50, 50, 50, 5, 5, 50, 50, 50])


def test_obstacles_below_the_scan_plane_give_the_maximum_range() -> None:
    low = basin(height=0.9)
    assert (PlanarScanner(z_m=1.0).build(low).sector_ranges(POSES) == 100.0).all()
    assert (PlanarScanner(z_m=0.8).build(low).sector_ranges(POSES) < 25.0).all()
    assert (PlanarScanner(z_m=0.8, range_m=0.5).build(low).sector_ranges(POSES) == 0.5).all()


def test_a_scenario_selects_it() -> None:
    loaded = load("s1", overrides=["sensors.lidar={kind: planar, rays: 360, sectors: 12}"])
    assert loaded.scenario.sensors.lidar == PlanarScanner(rays=360, sectors=12)
