"""The scan on a GPU against the full scan: its kernels, run on the CPU, and on a GPU where there is one."""

from __future__ import annotations

import numpy as np
import pytest

from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.scenarios.loader import load
from dockctl.sim.devices import GPU, gpu_problem, vessel_model
from dockctl.sim.lidar.spinning import SpinningLidars
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from dockctl.sim.world import build_worlds
from tests.sim.lidar.test_noisy_scan import noise, poses
from tests.sim.lidar.test_spinning_sensor import clutter

pytest.importorskip("numba.cuda")
has_gpu = pytest.mark.skipif(bool(gpu_problem()), reason="needs an NVIDIA GPU and numba-cuda")
COARSE = SpinningLidars(azimuth_steps=180)


@pytest.mark.parametrize(("sigma_m", "lost"), [(None, 0.0), (0.03, 0.05)])
def test_the_kernels_give_the_ranges_of_the_full_scan(
    sigma_m: float | None, lost: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tests.sim.gpu.one_warp import sector_ranges

    sensor, eta = SpinningSensor(COARSE, clutter(0)), poses(1, 2, 25.0)
    given = None if sigma_m is None else noise(len(eta), sigma_m, lost)
    values = None if given is None else (given.seeds, given.sigma_m, given.lost_returns)
    found = sector_ranges(sensor._tables, 100.0, 8, eta, values, monkeypatch)
    np.testing.assert_allclose(found, sensor.sector_ranges_by_full_scan(eta, given), rtol=0, atol=1e-9)


@has_gpu
@pytest.mark.parametrize("noisy", [False, True])
def test_a_gpu_gives_the_ranges_of_the_cpu(noisy: bool) -> None:
    marina = build_worlds(load("s3").scenario, load("s3").base_dir)[0]
    eta = np.random.default_rng(1).uniform((14, -14, -3), (36, 14, 3), (500, 3))
    sensor, on_gpu, given = marina.lidar, marina.lidar.on_gpu, noise(500, 0.03, 0.05)
    if noisy:
        one, other = sensor.noisy_sector_ranges(eta, given), on_gpu.noisy_sector_ranges(eta, given)
    else:
        one, other = sensor.sector_ranges(eta), on_gpu.sector_ranges(eta)
    # Logarithms and cosines of the noise are rounded differently.
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 if noisy else 0)


@has_gpu
def test_a_gpu_integrates_as_the_cpu() -> None:
    vessel, rng = load("s3").scenario.vessel, np.random.default_rng(2)
    eta, nu = rng.normal(size=(100, 3)), rng.normal(scale=0.3, size=(100, 3))
    command = rng.uniform(-1, 1, (100, 2)) * vessel.command_limit
    for one, other in zip(
        vessel_model(vessel, "cpu").step(eta, nu, command),
        vessel_model(vessel, GPU).step(eta, nu, command),
        strict=True,
    ):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


@pytest.mark.skipif(not gpu_problem(), reason="there is a GPU")
def test_without_a_gpu_the_device_is_an_error() -> None:
    with pytest.raises(DockctlError, match="cannot run on 'cuda'") as caught:
        DockingVectorEnv("s1", device="cuda")
    assert caught.value.code == "unavailable"


def test_an_unknown_device_is_an_error() -> None:
    with pytest.raises(DockctlError, match="unknown device 'gpu'"):
        DockingVectorEnv("s1", device="gpu")
