"""Peak memory of a training run, estimated before it starts and compared with what is available."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from dockctl.agents.algorithms import MemoryUse, algorithm_of
from dockctl.agents.interface import Spaces
from dockctl.envs.observation import ObservationEncoder
from dockctl.errors import DockctlError
from dockctl.scenarios.schema import Scenario
from dockctl.sim.world import World

# Measured on the reference marina with full LiDARs.
BOAT_BYTES = 20_000  # state, observation, info and reward sums, per boat
HARBOR_BYTES = 5_400_000  # collision surfaces and distance maps, per harbor; of 64 generated ones
WORKING_BYTES = 80_000_000  # compiled kernels, thread stacks, buffers of validations and tables

GB = 1e9


@dataclass(frozen=True)
class Estimate:
    """Peak memory of a training run [bytes]: current resident size, and the parts to be allocated."""

    resident: int
    parts: tuple[MemoryUse, ...]

    @property
    def needed(self) -> int:
        return sum(part.size for part in self.parts)

    @property
    def peak(self) -> int:
        return self.resident + self.needed

    def __str__(self) -> str:
        """Return one line, for example ``0.9 GB at its peak (libraries and harbor 0.47, ...)``."""
        shares = [("libraries and harbor", self.resident), *((part.name, part.size) for part in self.parts)]
        listed = ", ".join(f"{name} {size / GB:,.2f}" for name, size in shares if size >= 0.01 * GB)
        return f"{self.peak / GB:,.1f} GB at its peak ({listed})"


def estimate(scenario: Scenario, worlds: Sequence[World]) -> Estimate:
    """Estimate the peak memory of a training run.

    Args:
        worlds: built, but without the tables of their range sensors.
    """
    training, lidar = scenario.training, scenario.sensors.lidar
    observation = ObservationEncoder(scenario.observation, lidar.sectors).space
    own = sum(world.lidar.table_bytes for world in worlds)
    spaces = Spaces(observation, scenario.actions.space(scenario.vessel))
    boats = training.boats * (BOAT_BYTES + 4 * training.n_step * observation.shape[0])
    parts = (
        MemoryUse("LiDAR tables", lidar.shared_bytes + own, "sensors.lidar"),
        MemoryUse("collisions", HARBOR_BYTES * len(worlds), "harbor"),
        *algorithm_of(training).memory(spaces, training),
        MemoryUse("boats", boats, "training.boats"),
        MemoryUse("work", WORKING_BYTES, ""),
    )
    return Estimate(psutil.Process().memory_info().rss, parts)


def require_memory(scenario: Scenario, worlds: Sequence[World]) -> Estimate:
    """Estimate the memory of a training run, and check that it is available.

    Raises:
        DockctlError: it is not; the message names the field that needs the most.
    """
    estimated, available = estimate(scenario, worlds), available_bytes()
    if estimated.needed > available:
        largest = max(estimated.parts, key=lambda part: part.size)
        raise DockctlError(
            f"{largest.field}: this run needs {estimated}; {estimated.needed / GB:,.1f} GB of that are"
            f" still to be allocated, and {available / GB:,.1f} GB are available",
            code="unavailable",
        )
    return estimated


def available_bytes(root: Path = Path("/")) -> int:
    """Return the memory that this process can still allocate [bytes].

    Args:
        root: root of the file system that contains the control groups.
    """
    machine: int = psutil.virtual_memory().available
    return min([machine, *_group_bytes(root)])


def _group_bytes(root: Path) -> Iterator[int]:
    """Yield the memory left [bytes] in each control group of this process, version 1 or 2, and its parents.

    psutil reports the machine's memory, but in a container or batch job the limit of the group applies.
    """
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if not controllers:
            top, limit, usage = root / "sys/fs/cgroup", "memory.max", "memory.current"
        elif "memory" in controllers.split(","):
            top = root / "sys/fs/cgroup/memory"
            limit, usage = "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        inner = top / group.lstrip("/")
        for folder in (inner, *(parent for parent in inner.parents if parent.is_relative_to(top))):
            with suppress(OSError, ValueError):  # no such file, or "max": no limit
                statistics = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
                cache = int(statistics["inactive_file"])  # freed when memory is needed
                yield int((folder / limit).read_text()) - int((folder / usage).read_text()) + cache
