"""The fast scan with noise against the full scan with noise; its bias; lost returns and sectors."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.noise import may_exceed, normal
from dockctl.scenarios.extensions import RangeNoise
from dockctl.scenarios.loader import load
from dockctl.sim.lidar.planar import PlanarScanner
from dockctl.sim.lidar.scan import angle_of
from dockctl.sim.lidar.spinning import THESIS_MOUNTS, LidarMount, SpinningLidars
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from tests.sim.lidar.test_spinning_sensor import clutter

COARSE = SpinningLidars(azimuth_steps=180)


def noise(rows: int, sigma_m: float, lost: float = 0.0, seed: int = 0) -> RangeNoise:
    seeds = np.random.default_rng(seed).integers(2**63, size=rows).astype(np.uint64)
    return RangeNoise(seeds, np.full(rows, sigma_m), np.full(rows, lost), np.zeros(rows))


def poses(rows: int, seed: int, spread: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-spread, spread, (rows, 2)), rng.uniform(-4, 4, rows)])


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("sigma_m", "lost"), [(0.03, 0.0), (0.3, 0.0), (0.03, 0.05), (0.0, 0.5), (1.0, 0.9), (2.0, 0.0)]
)
def test_the_fast_scan_equals_the_full_scan_with_the_same_noise(
    sigma_m: float, lost: float, seed: int
) -> None:
    """Returns are also beside and below the boat, and every sector boundary is crossed by some."""
    sensor = SpinningSensor(COARSE, clutter(seed))
    eta = poses(25, seed, 25.0)
    given = noise(25, sigma_m, lost, seed)
    fast = sensor.noisy_sector_ranges(eta, given)
    np.testing.assert_allclose(fast, sensor.sector_ranges_by_full_scan(eta, given), rtol=0, atol=1e-9)
    assert not np.array_equal(fast, sensor.sector_ranges(eta))


@pytest.mark.parametrize(("sigma_m", "lost"), [(0.03, 0.03), (0.5, 0.3), (2.0, 0.0)])
def test_beside_and_above_low_piers(sigma_m: float, lost: float) -> None:
    """Most returns are then inside of the core; large errors move them past the boat, to any sector."""
    steep = (
        LidarMount(pitch_deg=75, yaw_deg=yaw, x_m=0, y_m=y, z_m=3) for yaw, y in ((90, 0.5), (270, -0.5))
    )
    piers = [
        np.array(trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.6, 12, height]]).triangles)
        for x, height in ((0.0, 0.5), (5.0, 1.0), (10.0, 0.3))
    ]
    sensor = SpinningSensor(
        SpinningLidars(azimuth_steps=180, sectors=16, mounts=(*THESIS_MOUNTS, *steep)), np.concatenate(piers)
    )
    x = np.concatenate([pier + np.linspace(-2.0, 2.5, 10) for pier in (0.0, 5.0, 10.0)])
    rng = np.random.default_rng(3)
    eta = np.column_stack([x, rng.uniform(-1, 13, len(x)), rng.uniform(-4, 4, len(x))])
    given = noise(len(eta), sigma_m, lost)
    exact = sensor.sector_ranges_by_full_scan(eta, given)
    np.testing.assert_allclose(sensor.noisy_sector_ranges(eta, given), exact, rtol=0, atol=1e-9)


@pytest.mark.parametrize("error", [0.0, 0.5, 2.0, 4.5, 6.0])
def test_may_exceed_holds_of_every_number_that_does(error: float) -> None:
    share = math.exp(-(error**2) / 2)
    numbers = np.array([normal(7, index) for index in range(20_000)])
    kept = np.array([may_exceed(7, index, share) for index in range(20_000)])
    assert kept[abs(numbers) > error].all()
    assert kept.mean() == pytest.approx(share, abs=4 * math.sqrt(share / 20_000))


def test_no_point_of_a_ray_turns_farther_than_the_bound_and_some_nearly_as_far() -> None:
    """Points outside 2 m, of rays from 1.2 m, moved by 0.15 m; angles by products."""
    rng, count, (error, radius, offset) = np.random.default_rng(0), 500_000, (0.15, 2.0, 1.2)
    at, towards = rng.uniform(-math.pi, math.pi, (2, count))
    origin = offset * np.array([np.cos(at), np.sin(at)])
    ray = np.array([np.cos(towards), np.sin(towards)])
    x, y = origin + ray * rng.uniform(0, 4, count)
    far = np.hypot(x, y) >= radius
    moved_x, moved_y = np.array([x, y]) + ray * rng.choice([-error, error], count)
    turned = np.abs(np.arctan2(x * moved_y - y * moved_x, x * moved_x + y * moved_y))[far]
    assert 0.95 * angle_of(error, radius, offset) < turned.max() <= angle_of(error, radius, offset)
    assert angle_of(3.0, radius, offset) == math.pi


def test_without_noise_it_is_the_scan() -> None:
    sensor, eta = SpinningSensor(COARSE, clutter(4)), poses(60, 4, 25.0)
    assert np.array_equal(sensor.noisy_sector_ranges(eta, noise(60, 0.0)), sensor.sector_ranges(eta))


def test_the_nearest_of_many_noisy_returns_is_too_near() -> None:
    """About sigma sqrt(2 ln N) for N returns at nearly the same range: the mean of the minimum of normals."""
    half, rows = 500.0, 200
    wall = np.array(
        [[[5, -half, -1], [5, half, -1], [5, half, 50]], [[5, -half, -1], [5, half, 50], [5, -half, 50]]]
    )
    scanner = PlanarScanner(rays=8000, range_m=100.0).build(wall)
    eta, given = np.zeros((rows, 3)), noise(rows, 0.03)
    error = scanner.noisy_sector_ranges(eta, given)[:, 3:5] - scanner.sector_ranges(eta)[:, 3:5]
    angle = np.arange(1000) * (2 * np.pi / 8000)
    draws = np.random.default_rng(0).normal(0, 0.03, (2000, 1000))
    expected = (5 / np.cos(angle) + draws).min(axis=1) - 5
    assert error.mean() == pytest.approx(expected.mean(), abs=0.003)
    assert error.std() == pytest.approx(expected.std(), rel=0.15)
    assert error.mean() < -0.05


def test_lost_sectors_read_the_range_of_the_sensor() -> None:
    text = "conditions={lidar_noise: {lost_sectors: 0.25}}"
    noisy, exact = (DockingVectorEnv(load("s1", overrides=o), 40) for o in ([text], []))
    shares = []
    for env in (noisy, exact):
        env.reset(seed=2)
    for _ in range(5):
        seen, true = (env.step(np.full(40, 38))[4]["sector_ranges_m"] for env in (noisy, exact))
        lost = seen != true
        assert (seen[lost] == 100).all()
        shares.append(lost)
    share = np.mean(shares)
    assert share == pytest.approx(0.25 * np.mean(true < 100), abs=4 * math.sqrt(0.25 * 0.75 / 1600))
    assert not np.array_equal(shares[0], shares[1])


def test_noise_needs_a_sensor_that_has_it() -> None:
    text = "conditions={lidar_noise: {sigma_m: 0.03}, more: {kind: lidar_noise}}"
    with pytest.raises(DockctlError):
        DockingVectorEnv(load("s1", overrides=[text]), 1)
