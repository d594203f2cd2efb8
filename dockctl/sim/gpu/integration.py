"""The equations of motion on the GPU: one thread for each boat."""

from __future__ import annotations

from typing import Any

import numpy as np

from dockctl.geometry import Floats
from dockctl.sim.gpu.kernels import blocks, cuda, kernel, to_gpu
from dockctl.sim.integration import advance
from dockctl.sim.vessel import VesselModel

THREADS = 64
"""Threads of a block."""


class GpuVesselModel(VesselModel):
    """`VesselModel` on the GPU; paths, which few boats need, are integrated on the CPU."""

    def _integrate(
        self, eta: Floats, nu: Floats, tau: Floats, coefficients: Floats | None, states: Floats
    ) -> tuple[Floats, Floats, Floats]:
        if len(states) or len(eta) == 0:
            return super()._integrate(eta, nu, tau, coefficients, states)
        own = self.coefficients if coefficients is None else coefficients
        h = self.vessel.control_period_s / self.vessel.substeps
        on_gpu = to_gpu(
            [eta, nu, tau, own, h, self.vessel.substeps, self.vessel.hull.reach_m, states, np.empty(len(eta))]
        )
        _integrate[blocks(len(eta), THREADS), THREADS](*on_gpu)
        after, velocity, *_, travel = on_gpu
        return after.copy_to_host(), velocity.copy_to_host(), travel.copy_to_host()


@kernel
def _integrate(
    eta: Any, nu: Any, tau: Any, own: Any, h: float, substeps: int, reach: float, states: Any, travel: Any
) -> None:
    i = cuda.grid(1)
    if i < len(eta):
        travel[i] = advance(i, eta, nu, tau, own, h, substeps, reach, states)
