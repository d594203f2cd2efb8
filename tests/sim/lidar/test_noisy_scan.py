"""The fast scan with noise against the full scan with noise; its bias; lost returns and sectors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.scenarios.extensions import RangeNoise
from dockctl.scenarios.loader import load
from dockctl.sim.lidar.planar import PlanarScanner
from dockctl.sim.lidar.spinning import SpinningLidars
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
@pytest.mark.parametrize(("sigma_m", "lost"), [(0.03, 0.0), (0.3, 0.0), (0.03, 0.05), (0.0, 0.5), (1.0, 0.9)])
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
