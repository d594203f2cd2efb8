"""How much memory a training will take at its peak, and whether the machine has it."""

from __future__ import annotations

import os
import resource
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from gymnasium.spaces import flatdim

from dockctl.agents.dqn.replay import Replay
from dockctl.envs.spaces import ObservationEncoder
from dockctl.errors import DockctlError
from dockctl.scenarios.schema import Scenario
from dockctl.sim.world import World

# Measured on the reference marina with full LiDARs.
BOAT_BYTES = 20_000  # of state, observations, info and episode's sums, for each boat
WORKING_BYTES = 80_000_000  # compiled kernels, threads' stacks, and what an evaluation and the tables hold
COPIES_IN_SAVING = 3  # of all that a checkpoint holds: in rows, as bytes, and as the file's content

GB = 1e9


class Part(NamedTuple):
    """One use of memory: what for, [bytes], and the field of the scenario that decides on it."""

    name: str
    size: int
    field: str


@dataclass(frozen=True)
class Estimate:
    """Peak memory of a training [bytes]: what the process holds already, and the parts to come."""

    held: int
    parts: tuple[Part, ...]

    @property
    def to_come(self) -> int:
        return sum(part.size for part in self.parts)

    @property
    def peak(self) -> int:
        return self.held + self.to_come

    def __str__(self) -> str:
        """In a line, for example ``0.9 GB at its peak (libraries and harbor 0.47, ...)``."""
        shares = [("libraries and harbor", self.held), *((part.name, part.size) for part in self.parts)]
        listed = ", ".join(f"{name} {size / GB:,.2f}" for name, size in shares if size >= 0.01 * GB)
        return f"{self.peak / GB:,.1f} GB at its peak ({listed})"


def estimate(scenario: Scenario, worlds: Sequence[World]) -> Estimate:
    """Estimate the peak memory of training in worlds that are built, before their LiDARs' tables are."""
    training = scenario.training
    size = len(ObservationEncoder(scenario.observation, scenario.sensors.lidar.sectors).names)
    actions = flatdim(scenario.actions.space(scenario.vessel))
    parameters, outputs = network_size(size, actions, training.hidden_sizes)
    replay = Replay.bytes_needed(min(training.replay_capacity, training.total_steps), size)
    # Online, target, two moments, and the gradient, for which torch has room of its own, too; the first four
    # are saved.
    networks = 4 * (6 + 4 * COPIES_IN_SAVING) * parameters
    # Outputs of two observations, of the target and slopes, and about as much for what is on the way.
    batches = 4 * 6 * training.batch_size * (outputs + size)
    boats = training.boats * (BOAT_BYTES + 4 * training.n_step * size)
    parts = (
        Part("LiDAR tables", sum(world.lidar.table_bytes for world in worlds), "sensors.lidar"),
        Part("replay", replay, "training.replay_capacity"),
        Part("saving the replay", COPIES_IN_SAVING * replay, "training.replay_capacity"),
        Part("networks", networks, "training.hidden_sizes"),
        Part("batches", batches, "training.batch_size"),
        Part("boats", boats, "training.boats"),
        Part("work", WORKING_BYTES, ""),
    )
    return Estimate(held_bytes(), parts)


def network_size(observation_size: int, actions: int, hidden_sizes: Sequence[int]) -> tuple[int, int]:
    """Number of parameters of the dueling network, and of outputs of its layers."""
    width = hidden_sizes[-1]
    layers = [*pairwise((observation_size, *hidden_sizes))]
    layers += [(width, width), (width, 1), (width, actions), (actions, actions)]
    return sum((inputs + 1) * outputs for inputs, outputs in layers), sum(outputs for _, outputs in layers)


def require_memory(scenario: Scenario, worlds: Sequence[World]) -> Estimate:
    """Estimate what a training takes, and check that it fits into the memory that is available.

    Raises:
        DockctlError: it does not fit.
    """
    needed, available = estimate(scenario, worlds), available_bytes()
    if needed.to_come > available:
        largest = max(needed.parts, key=lambda part: part.size)
        raise DockctlError(
            f"{largest.field}: this training takes {needed}; {needed.to_come / GB:,.1f} GB of that are still"
            f" to come, and {available / GB:,.1f} GB are available here",
            code="unavailable",
        )
    return needed


def held_bytes() -> int:
    """Memory that this process holds [bytes]: at present where the system tells, else at its peak so far."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else 1024 * peak
    return pages * resource.getpagesize()


def available_bytes(root: Path = Path("/")) -> int:
    """Memory that this process can still take [bytes]: of the machine, and of its control groups if limited.

    Args:
        root: of the file system that holds proc and sys.
    """
    return min([_machine_bytes(root), *_group_bytes(root)])


def _machine_bytes(root: Path) -> int:
    try:
        lines = (root / "proc/meminfo").read_text().splitlines()
    except OSError:  # not Linux: all that there is
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    (free,) = [int(line.split()[1]) for line in lines if line.startswith("MemAvailable:")]
    return 1024 * free


def _group_bytes(root: Path) -> Iterator[int]:
    """What each control group of this process has left, version 1 or 2, itself and those around it."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, group = line.split(":", 2)
        if not controllers:
            top, limit, usage = root / "sys/fs/cgroup", "memory.max", "memory.current"
        elif "memory" in controllers.split(","):
            top, limit, usage = (
                root / "sys/fs/cgroup/memory",
                "memory.limit_in_bytes",
                "memory.usage_in_bytes",
            )
        else:
            continue
        inner = top / group.lstrip("/")
        for folder in (inner, *(parent for parent in inner.parents if parent.is_relative_to(top))):
            yield from _left(folder / limit, folder / usage, folder / "memory.stat")


def _left(limit: Path, usage: Path, statistics: Path) -> Iterator[int]:
    """What a group may still take; files that it has cached make room when it is needed."""
    try:
        most, used = int(limit.read_text()), int(usage.read_text())
        lines = [line.split() for line in statistics.read_text().splitlines()]
        cached = sum(int(line[1]) for line in lines if line[0] == "inactive_file")
    except (OSError, ValueError):  # no such file, or "max": no limit
        return
    yield most - used + cached
