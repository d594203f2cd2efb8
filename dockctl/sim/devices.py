"""Where boats are simulated: on the CPU, or on an NVIDIA GPU."""

from __future__ import annotations

from importlib.util import find_spec

from dockctl.errors import DockctlError
from dockctl.scenarios.extensions import RangeSensor
from dockctl.scenarios.vessel import Vessel
from dockctl.sim.vessel import VesselModel

CPU, GPU = "cpu", "cuda"


def require_device(device: str) -> None:
    """Check that boats can be simulated on a device.

    Raises:
        DockctlError: the device is unknown, or not available.
    """
    if device not in (CPU, GPU):
        message = f"unknown device '{device}' of the simulation (known: {CPU}, {GPU})"
        raise DockctlError(message, code="unknown_name")
    if device == GPU:
        problem = gpu_problem()
        if problem:
            raise DockctlError(f"the simulation cannot run on '{GPU}': {problem}", code="unavailable")


def gpu_problem() -> str:
    """Return what is missing for a simulation on the GPU, or an empty string."""
    if find_spec("numba_cuda") is None:
        return "numba-cuda is not installed: pip install 'dockctl[gpu]'"
    from dockctl.sim.gpu.kernels import cuda

    return "" if cuda.is_available() else "no NVIDIA GPU was found, or its driver is too old"


def vessel_model(vessel: Vessel, device: str) -> VesselModel:
    """Return the equations of motion of a vessel on a device."""
    if device == CPU:
        return VesselModel(vessel)
    from dockctl.sim.gpu.integration import GpuVesselModel

    return GpuVesselModel(vessel)


def sensor_on(device: str, sensor: RangeSensor) -> RangeSensor:
    """Return a range sensor on a device; one without an attribute `on_gpu` remains on the CPU."""
    on_gpu: RangeSensor = sensor if device == CPU else getattr(sensor, "on_gpu", sensor)
    return on_gpu
