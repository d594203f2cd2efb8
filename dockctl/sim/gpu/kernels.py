"""Kernels for the GPU, from the functions that are compiled for the CPU.

A kernel may call functions of `dockctl.compute.compiled`: numba compiles them for the GPU, so that each rule
is written once. Products and sums are rounded one by one, as on the CPU, instead of being fused. Otherwise a
ray that grazes an edge could hit on one and miss on the other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numba import cuda as numba_cuda
from numba import types
from numba.cuda.cudadrv import nvvm

from dockctl.compute import digest_of

cuda: Any = numba_cuda  # its functions have no types
WARP = 32
"""Threads of a warp, which run together."""
ALL_THREADS = 0xFFFFFFFF
"""The threads of a warp that take part in a vote."""
SIM = Path(__file__).parent.parent

nvvm.compile_ir = partial(nvvm.compile_ir, fma=False)  # not an option of `cuda.jit`
cuda.config.CUDA_LOW_OCCUPANCY_WARNINGS = 0  # one boat is a valid batch


class _Nothing:
    """Lets numba pass None to a kernel."""

    def prepare_args(self, kind: Any, value: Any, **_: Any) -> tuple[Any, Any]:
        return (types.uint64, 0) if kind is types.none else (kind, value)


def kernel(function: Callable[..., None]) -> Any:
    """Compile a function for the GPU and cache it on disk; as in `compiled`, its name includes a hash."""
    function.__qualname__ += "".join(f"_{digest_of(folder)}" for folder in (SIM, SIM / "lidar"))
    # Optimization at link time would fuse products and sums.
    return cuda.jit(function, cache=True, lto=False, extensions=[_Nothing()])


def to_gpu(values: Iterable[Any]) -> list[Any]:
    """Copy the arrays among some values to the GPU; the others remain as they are."""
    # A copy has the strides of a new array, which numba's test for a contiguous array expects.
    return [cuda.to_device(np.array(each)) if isinstance(each, np.ndarray) else each for each in values]


def blocks(threads: int, per_block: int) -> int:
    """Return the number of blocks for a number of threads."""
    return -(-threads // per_block)
