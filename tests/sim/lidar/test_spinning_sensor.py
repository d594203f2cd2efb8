"""The LiDAR scan against closed forms, another ray tracer and the reference implementation."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from dockctl.errors import DockctlError
from dockctl.scenarios.loader import load
from dockctl.sim.lidar import height_grid
from dockctl.sim.lidar import spinning_sensor as lidar_module
from dockctl.sim.lidar.height_grid import (
    HeightGrid,
    band_at,
    bands_in,
    bands_near,
    bits,
    distance_at,
    in_tiles,
)
from dockctl.sim.lidar.raycast import BoundingVolumes, closest_hits
from dockctl.sim.lidar.scan import half_sides
from dockctl.sim.lidar.spinning import LidarMount, SpinningLidars
from dockctl.sim.lidar.spinning_sensor import Rays, SpinningSensor, rotation
from dockctl.sim.world import build_worlds

COARSE = SpinningLidars(azimuth_steps=180)


def clutter(seed: int, solids: int = 40, spread: float = 25.0) -> np.ndarray:
    """A random field of boxes, balls and thin masts, some of them at the water surface."""
    rng = np.random.default_rng(seed)
    meshes = []
    for index in range(solids):
        kind = index % 3
        if kind == 0:
            mesh = trimesh.creation.box(extents=rng.uniform(0.3, 4.0, 3))
        elif kind == 1:
            mesh = trimesh.creation.icosphere(subdivisions=2, radius=rng.uniform(0.3, 2.0))
        else:
            mesh = trimesh.creation.cylinder(radius=0.06, height=rng.uniform(2, 12), sections=8)
        mesh.apply_transform(trimesh.transformations.rotation_matrix(rng.uniform(0, 6), [0, 0, 1]))
        mesh.apply_translation([*rng.uniform(-spread, spread, 2), rng.uniform(-0.5, 2.5)])
        meshes.append(mesh)
    return np.array(trimesh.util.concatenate(meshes).triangles)


def wall(x: float, height: float) -> np.ndarray:
    """A wide wall ahead of the boat at distance x."""
    box = trimesh.creation.box(bounds=[[x, -200.0, -1.0], [x + 1.0, 200.0, height]])
    return np.array(box.triangles)


def test_rotation_is_the_matrix_of_equation_3_2() -> None:
    mount = LidarMount(roll_deg=10, pitch_deg=27, yaw_deg=70, x_m=0, y_m=0, z_m=0)
    a, b, c = np.radians([10, 27, 70])
    sa, ca, sb, cb, sc, cc = np.sin(a), np.cos(a), np.sin(b), np.cos(b), np.sin(c), np.cos(c)
    by_the_book = [
        [cc * cb, cc * sb * sa - ca * sc, sc * sa + cc * ca * sb],
        [cb * sc, cc * ca + sc * sb * sa, ca * sc * sb - cc * sa],
        [-sb, cb * sa, cb * ca],
    ]
    np.testing.assert_allclose(rotation(mount), by_the_book, atol=1e-15)


def test_a_scan_has_every_ray_of_four_vlp16() -> None:
    rays = Rays.from_spec(SpinningLidars())
    assert len(rays.directions) == 4 * 16 * 1800 == 115_200
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1.0)
    assert 0.45 < np.mean(rays.directions[:, 2] > 0) < 0.55  # half of them point up
    in_sensor = rays.directions[:28_800] @ rotation(SpinningLidars().mounts[0])
    elevation = np.degrees(np.arcsin(in_sensor[:, 2])).reshape(16, 1800)
    np.testing.assert_allclose(elevation[:, 0], np.arange(-15, 16, 2), atol=1e-9)
    np.testing.assert_allclose(np.ptp(elevation, axis=1), 0, atol=1e-9)


def test_rays_end_at_the_water() -> None:
    rays = Rays.from_spec(SpinningLidars())
    ends = rays.origins + rays.reach[:, None] * rays.directions
    assert ends[:, 2].min() > -1e-9
    assert rays.reach.max() == 100.0


def test_open_water_gives_the_maximum_range() -> None:
    array = SpinningSensor(COARSE, np.empty((0, 3, 3)))
    np.testing.assert_array_equal(array.sector_ranges(np.zeros((2, 3))), np.full((2, 8), 100.0))
    np.testing.assert_array_equal(array.sector_ranges_by_full_scan(np.zeros((2, 3))), np.full((2, 8), 100.0))


def test_a_wall_ahead_is_seen_at_its_distance() -> None:
    """The wall is at x = 7: the two bow sectors give 7 m, the next two 7 / cos 45 degrees."""
    ranges = SpinningSensor(SpinningLidars(), wall(7.0, 4.0)).sector_ranges(np.zeros((1, 3)))[0]
    np.testing.assert_allclose(ranges[[3, 4]], 7.0, atol=1e-3)
    np.testing.assert_allclose(ranges[[2, 5]], 7.0 * math.sqrt(2), atol=0.05)
    np.testing.assert_array_equal(ranges[[0, 1, 6, 7]], 100.0)


def test_a_near_wall_hides_a_far_one() -> None:
    both = np.concatenate([wall(7.0, 40.0), wall(12.0, 80.0)])
    points = SpinningSensor(SpinningLidars(), both).points(np.zeros(3))
    assert points[points[:, 0] > 8.01, 2].min() > 40.0


def test_every_third_ray_gives_its_points() -> None:
    triangles, pose, rays = clutter(0), np.array([1.0, -2.0, 0.3]), Rays.from_spec(COARSE)
    sensor = SpinningSensor(COARSE, triangles)
    hits = BoundingVolumes.build(triangles).trace(pose, rays.origins, rays.directions, rays.reach)
    seen = np.flatnonzero(np.isfinite(hits))
    np.testing.assert_array_equal(sensor.points(pose, 3), sensor.points(pose)[seen % 3 == 0])


@pytest.mark.parametrize("heading", [0.0, 45.0, 90.0, 180.0, 270.0])
def test_sectors_rotate_with_the_boat(heading: float) -> None:
    """A mast due east of the boat is in the sector of the body-frame azimuth -heading."""
    mast = trimesh.creation.cylinder(radius=0.3, height=12, sections=32)
    mast.apply_translation([10.0, 1.0, 2.0])
    ranges = SpinningSensor(SpinningLidars(), np.array(mast.triangles)).sector_ranges(
        np.array([[0, 0, math.radians(heading)]])
    )[0]
    azimuth = math.atan2(1.0, 10.0) - math.radians(heading)
    sector = int((azimuth + math.pi) % (2 * math.pi) / (math.pi / 4))
    assert np.argmin(ranges) == sector
    assert ranges[sector] == pytest.approx(math.hypot(10, 1) - 0.3, abs=0.02)


@pytest.mark.parametrize("seed", range(4))
def test_fast_scan_equals_full_scan_bit_for_bit(seed: int) -> None:
    array = SpinningSensor(COARSE, clutter(seed))
    rng = np.random.default_rng(seed + 100)
    poses = np.column_stack([rng.uniform(-30, 30, (60, 2)), rng.uniform(-7, 7, 60)])
    np.testing.assert_array_equal(array.sector_ranges(poses), array.sector_ranges_by_full_scan(poses))


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10_000), pitch=st.floats(-80, 80), channels=st.integers(1, 5), reach=st.floats(3, 200)
)
def test_fast_scan_equals_full_scan_for_any_sensor(
    seed: int, pitch: float, channels: int, reach: float
) -> None:
    mounts = (
        LidarMount(pitch_deg=pitch, yaw_deg=20.0, x_m=0.4, y_m=-0.7, z_m=2.0),
        LidarMount(pitch_deg=90.0 - pitch, roll_deg=13.0, yaw_deg=200.0, x_m=-1.5, y_m=0.0, z_m=0.7),
    )
    spec = SpinningLidars(channels=channels, azimuth_steps=73, range_m=reach, mounts=mounts, sectors=6)
    array = SpinningSensor(spec, clutter(seed, solids=30, spread=8.0))
    poses = np.random.default_rng(seed).uniform(-8, 8, (10, 3))
    np.testing.assert_array_equal(array.sector_ranges(poses), array.sector_ranges_by_full_scan(poses))


def test_fast_scan_equals_full_scan_in_the_reference_marina() -> None:
    """At full resolution: in the fairway, in the berth, alongside piers and across moored vessels."""
    loaded = load("s3")
    (world,) = build_worlds(loaded.scenario, loaded.base_dir)
    array = world.lidar
    anywhere = np.random.default_rng(4).uniform((4.5, -40, -4), (38.5, 40, 4), (12, 3))
    chosen = [[20, 2, 2.8], [36, 0, np.pi], [33, 4, 0.3], [36, -2, 1.0], [7, -2, 0.0], [30.6, -2.5, 2.0]]
    poses = np.concatenate([anywhere, chosen])
    np.testing.assert_array_equal(array.sector_ranges(poses), array.sector_ranges_by_full_scan(poses))


def test_full_scan_equals_embree() -> None:
    """Embree computes in float32, so that ranges agree to a millimeter."""
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    triangles = clutter(7)
    mesh = trimesh.Trimesh(
        triangles.reshape(-1, 3), np.arange(len(triangles) * 3).reshape(-1, 3), process=False
    )
    array = SpinningSensor(COARSE, triangles)
    peer = RayMeshIntersector(mesh)
    rays = array.rays
    for x, y, heading in np.random.default_rng(3).uniform(-20, 20, (10, 3)):
        c, s = math.cos(heading), math.sin(heading)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        origins, directions = rays.origins @ turn.T + [x, y, 0], rays.directions @ turn.T
        locations, index, _ = peer.intersects_location(origins, directions, multiple_hits=False)
        within = np.linalg.norm(locations - origins[index], axis=1) <= rays.reach[index]
        body = (locations[within] - [x, y, 0]) @ turn
        expected = np.full(8, 100.0)
        sectors = np.minimum(((np.arctan2(body[:, 1], body[:, 0]) + np.pi) / (np.pi / 4)).astype(int), 7)
        np.minimum.at(expected, sectors, np.hypot(body[:, 0], body[:, 1]))
        np.testing.assert_allclose(
            array.sector_ranges_by_full_scan(np.array([[x, y, heading]]))[0], expected, atol=1e-3
        )


def test_closest_hits_equal_brute_force() -> None:
    rng = np.random.default_rng(11)
    triangles = rng.uniform(-1, 1, (200, 3, 3))
    origins, directions = rng.uniform(-2, 2, (300, 3)), rng.normal(size=(300, 3))
    volumes = BoundingVolumes.build(triangles)
    found = closest_hits(
        volumes.boxes, volumes.children, volumes.triangles, origins, directions, np.full(300, np.inf)
    )
    for origin, direction, t in zip(origins, directions, found, strict=True):
        columns = np.stack(
            [
                np.tile(-direction, (200, 1)),
                triangles[:, 1] - triangles[:, 0],
                triangles[:, 2] - triangles[:, 0],
            ],
            2,
        )
        solved = np.linalg.solve(columns, (origin - triangles[:, 0])[..., None])[..., 0]
        inside = (
            (solved[:, 0] >= 0)
            & (solved[:, 1] >= 0)
            & (solved[:, 2] >= 0)
            & (solved[:, 1] + solved[:, 2] <= 1)
        )
        assert t == pytest.approx(solved[inside, 0].min(initial=np.inf), rel=1e-9)


def test_ranges_do_not_depend_on_the_batch_or_the_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    array = SpinningSensor(COARSE, clutter(2))
    poses = np.random.default_rng(1).uniform(-20, 20, (33, 3))
    together = array.sector_ranges(poses)
    alone = np.concatenate([array.sector_ranges(pose[None]) for pose in poses])
    np.testing.assert_array_equal(together, alone)
    monkeypatch.setattr(lidar_module, "usable_cores", lambda: 1)
    np.testing.assert_array_equal(together, array.sector_ranges(poses))


@pytest.mark.thorough
def test_the_grid_is_conservative() -> None:
    """Bands contain, and distances do not exceed, those of points sampled on the triangles."""
    triangles = clutter(5)
    rng = np.random.default_rng(0)
    weights = rng.dirichlet([1, 1, 1], (len(triangles), 8))
    points = np.einsum("tki,tij->tkj", weights, triangles).reshape(-1, 3)
    points = points[points[:, 2] >= 0]
    grid = HeightGrid.build(triangles, 2.0)
    x0, y0, cell = grid.frame
    _, nx, ny, _ = grid.level_shape[0]
    heights = np.array([bits(band_at(z), band_at(z)) for z in points[:, 2]])
    assert grid.radii[0] == 0.0 and grid.radii[-1] >= 2.0
    for x, y in rng.uniform([x0, y0], [x0 + nx * cell, y0 + ny * cell], (300, 2)):
        away = np.hypot(points[:, 0] - x, points[:, 1] - y)
        assert distance_at(grid, x, y) <= away.min()
        for level, radius in enumerate(grid.radii):
            expected = np.bitwise_or.reduce(heights[away <= radius], initial=0)
            assert bands_near(grid, level, x, y) & expected == expected
        reach_x, reach_y = rng.uniform(0, 1, 2)
        inside = (np.abs(points[:, 0] - x) <= reach_x) & (np.abs(points[:, 1] - y) <= reach_y)
        expected = np.bitwise_or.reduce(heights[inside], initial=0)
        assert bands_in(grid, x, y, reach_x, reach_y) & expected == expected
    for (x, y, _), height in zip(points, heights, strict=True):
        assert bands_near(grid, 0, x, y) & height


def test_bands_in_a_box_are_those_of_its_cells() -> None:
    grid = HeightGrid.build(clutter(5), 2.0)
    x0, y0, cell = grid.frame
    rng = np.random.default_rng(1)
    for ix, iy in rng.integers(20, 300, (200, 2)):
        cells = [bands_near(grid, 0, x0 + (ix + i) * cell, y0 + (iy + j) * cell)
                 for i in (-0.5, 0.5, 1.5) for j in (-1.5, -0.5, 0.5, 1.5, 2.5)]  # fmt: skip
        x, y = x0 + (ix + 0.5) * cell, y0 + (iy + 0.5) * cell
        assert bands_in(grid, x, y, 1.4 * cell, 2.4 * cell) == np.bitwise_or.reduce(cells)


@given(inner=st.floats(0.5, 200), growth=st.floats(1.0001, 2), bins=st.integers(4, 2048), at=st.floats(-1, 1))
def test_a_cell_of_a_shell_is_inside_its_rectangle(inner: float, growth: float, bins: int, at: float) -> None:
    outer, half_width = inner * growth, math.pi / bins
    depth, width = half_sides(inner, outer, half_width)
    radii = np.linspace(inner, outer, 50)
    ahead, aside = radii * math.cos(at * half_width), radii * math.sin(at * half_width)
    assert (np.abs(ahead - (inner + outer) / 2) <= depth).all() and (np.abs(aside) <= width).all()
    assert depth <= outer - inner * math.cos(half_width) + 1e-4 and width <= 1.6 * outer * half_width


def test_triangles_of_a_cell_have_their_bands_of_height() -> None:
    triangles = clutter(6)
    grid = HeightGrid.build(triangles, 1.0)
    x0, y0, cell = grid.frame
    nx = grid.level_shape[0, 1]
    corners = grid.triangles[:, :3]
    assert len(corners) == (triangles[:, :, 2].max(axis=1) >= 0).sum()
    for index in np.flatnonzero(corners[:, 2] >= 0)[::7]:
        x, y, z = corners[index]
        tile, place = divmod(in_tiles(int((x - x0) / cell), int((y - y0) / cell), nx), 64)
        number = grid.list_tiles[grid.list_directory[tile], place]
        members = grid.members[grid.starts[number] : grid.starts[number + 1]]
        (member,) = members[members["triangle"] == index]
        assert member["low"] <= band_at(z) <= member["high"]


def test_a_grid_stores_equal_tiles_once() -> None:
    """A quay of 40 x 40 m: most of its cells, and of the water around it, are in one of two tiles."""
    quay = trimesh.creation.box(bounds=[[0.0, 0.0, -1.0], [40.0, 40.0, 0.6]])
    grid = HeightGrid.build(np.array(quay.triangles), 0.5)
    assert len(grid.list_directory) > 50 * 50
    assert len(grid.list_tiles) < 0.2 * len(grid.list_directory)
    assert len(grid.tiles) < 0.2 * len(grid.directory)
    assert len(grid.members) < 20_000


@given(low=st.floats(-2, 30), size=st.floats(0, 30))
def test_bands_are_contiguous_bits_that_grow_with_the_interval(low: float, size: float) -> None:
    first, last = band_at(low), band_at(low + size)
    bands = bits(first, last)
    assert bands & bits(first, first)
    assert bands & bits(last, last)
    assert bits(first, band_at(low + 2 * size)) & bands == bands
    lowest_bit = bands & -bands
    assert (bands + lowest_bit) & bands == 0  # no gap


def test_a_grid_of_many_overlapping_triangles_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """One square meter is in 10 x 10 cells, and on the edges of more."""
    square = np.array([[(0, 0, 1), (1, 0, 1), (0, 1, 1)]], float)
    monkeypatch.setattr(height_grid, "MAX_MEMBERS", 1000)
    HeightGrid.build(np.repeat(square, 5, axis=0), 1.0)
    with pytest.raises(DockctlError, check=lambda error: error.code == "out_of_range"):
        HeightGrid.build(np.repeat(square, 11, axis=0), 1.0)
