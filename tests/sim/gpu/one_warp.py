"""Runs the kernels of the scan on the CPU: 32 threads play a warp, one warp after the other."""

from __future__ import annotations

import math
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np

from dockctl.geometry import Floats
from dockctl.sim.gpu import scan
from dockctl.sim.gpu.azimuth import edges_of
from dockctl.sim.gpu.kernels import WARP


class Warp:
    """What kernels use of `numba.cuda`; the threads of a vote or exchange wait for each other."""

    def __init__(self) -> None:
        self.atomic = self.shared = self
        self.thread, self.lock = threading.local(), threading.Lock()
        self.barrier, self.given = threading.Barrier(WARP), [None] * WARP
        self.block = self.first_thread = 0
        self.arrays: dict[int, np.ndarray] = {}

    @property
    def threadIdx(self) -> SimpleNamespace:
        return SimpleNamespace(x=self.first_thread + self.thread.lane)

    @property
    def blockIdx(self) -> SimpleNamespace:
        return SimpleNamespace(x=self.block, y=0)

    def array(self, shape: tuple[int, int], dtype: type) -> np.ndarray:
        self.thread.arrays += 1
        with self.lock:
            return self.arrays.setdefault(self.thread.arrays, np.zeros(shape, dtype))

    def exchange(self, value: Any) -> list[Any]:
        self.given[self.thread.lane] = value
        self.barrier.wait()
        values = list(self.given)
        self.barrier.wait()
        return values

    def any_sync(self, _: int, value: bool) -> bool:
        return any(self.exchange(value))

    def ballot_sync(self, _: int, value: bool) -> int:
        return sum(1 << lane for lane, each in enumerate(self.exchange(value)) if each)

    def shfl_sync(self, _: int, value: Any, lane: int) -> Any:
        return self.exchange(value)[lane]

    def shfl_xor_sync(self, _: int, value: Any, mask: int) -> Any:
        return self.exchange(value)[self.thread.lane ^ mask]

    def syncwarp(self) -> None:
        self.barrier.wait()

    def ffs(self, value: int) -> int:
        return (value & -value).bit_length()

    def popc(self, value: int) -> int:
        return value.bit_count()

    def min(self, array: np.ndarray, index: tuple[int, int], value: float) -> None:
        with self.lock:
            array[index] = min(array[index], value)

    def run(self, kernel: Any, arguments: tuple[Any, ...]) -> None:
        """Run the threads of a warp.

        Raises:
            Exception: the first that a thread raised.
        """
        raised: list[Exception] = []
        self.arrays.clear()

        def run(lane: int) -> None:
            self.thread.lane, self.thread.arrays = lane, 0
            try:
                kernel(*arguments)
            except threading.BrokenBarrierError:
                pass  # another thread raised
            except Exception as error:
                raised.append(error)
                self.barrier.abort()

        threads = [threading.Thread(target=run, args=(lane,)) for lane in range(WARP)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if raised:
            raise raised[0]


def sector_ranges(tables: Any, range_m: float, sectors: int, eta: Floats, noise: Any, patch: Any) -> Floats:
    """Return what `dockctl.sim.gpu.scan.GpuSensor` computes, (n, 3) to (n, sectors) [m]."""
    shells, grid, levels = tables
    tables = shells._replace(runs=shells.runs.view(np.recarray)), grid, levels
    cosine, sine = ([*map(function, eta[:, 2])] for function in (math.cos, math.sin))
    out = np.full((len(eta), sectors), range_m)
    arguments = *tables, edges_of(sectors), noise, np.column_stack([eta[:, :2], cosine, sine]), out
    warp = Warp()
    patch.setattr(scan, "cuda", warp)
    for name in ("_trace", "_sectors_near", "_polar"):
        patch.setattr(scan, name, getattr(scan, name).py_func)
    patch.setattr(scan, "CORE_THREADS", WARP)
    patch.setattr(scan, "CORE_BLOCKS", 1)
    for warp.block in range(len(eta)):
        warp.run(scan._scan_core.py_func, arguments)
    for number in range(len(eta) * sectors):
        warp.block, warp.first_thread = number // scan.WARPS, number % scan.WARPS * WARP
        warp.run(scan._scan_shells.py_func, arguments)
    return out
