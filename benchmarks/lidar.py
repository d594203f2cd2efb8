"""The LiDAR scan, compared with trimesh and embree, and with the reference implementation.

    python benchmarks/lidar.py

Fairway poses are between the rows of berths, berth poses on the approach to a berth. The slowest scans of
the whole basin are those under the overhang of a bow or a deck; poses in contact are left out, as they end
the episode.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable
from threading import Barrier, get_native_id

import bench  # before numpy
import numpy as np
import trimesh
from numpy.typing import NDArray
from trimesh.ray.ray_pyembree import RayMeshIntersector

from dockctl.compute import workers
from dockctl.geometry import Floats, nearest_in_sectors
from dockctl.scenarios.loader import load
from dockctl.sim.lidar import spinning_sensor as lidar_module
from dockctl.sim.lidar.shell_table import needed_radii
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from dockctl.sim.world import build_worlds

FAIRWAY = ((14.5, -14.0, -np.pi), (27.0, 14.0, np.pi))
BERTH = ((28.0, -1.0, 2.8), (36.0, 1.0, 3.5))
EMBREE = "trimesh + embree + numpy"
REFERENCE = "every ray, reference implementation"
SCAN = "dockctl"
BERTHING = "dockctl, approaching the berth"
ONE_CORE = "dockctl, one core, wall clock"
ALL_CORES = "dockctl, all cores, wall clock"
SPEED = "speed of a scan, relative to embree"


def embree_scanner(lidar: SpinningSensor) -> Callable[[Floats], Floats]:
    """Return a function that scans from one pose by embree, with the sector ranges by numpy.

    It queries only distances, which is faster than the methods of trimesh; with `scale_to_box` they would be
    in the units of a scaled copy.
    """
    corners = lidar.triangles.reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    intersector, rays = RayMeshIntersector(mesh, scale_to_box=False), lidar.rays
    intersector.intersects_first([[0.0, 0.0, 50.0]], [[0.0, 0.0, -1.0]])  # builds the scene

    def scan(pose: Floats) -> Floats:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        origins = (rays.origins @ turn.T + [pose[0], pose[1], 0.0]).astype(np.float32)
        directions = (rays.directions @ turn.T).astype(np.float32)
        distance = intersector._scene.run(origins, directions, query="DISTANCE")
        seen = distance <= rays.reach
        body = rays.origins[seen] + distance[seen, None] * rays.directions[seen]
        return nearest_in_sectors(body, lidar.spec.sectors, lidar.spec.range_m)

    return scan


def scans(lidar: SpinningSensor, poses: Floats, cores: int) -> bench.Case:
    """Return the case of scans from the poses on `cores` cores."""

    def work() -> None:
        lidar_module.usable_cores = lambda: cores
        lidar.sector_ranges(poses)

    return bench.Case(work, len(poses), cores)


def pin_threads(cores: int) -> None:
    """Pin each thread of the pool to its own core, as on an idle machine; the first is the main thread's."""
    barrier = Barrier(cores - 1)

    def pin(core: int) -> None:
        barrier.wait()  # every thread runs one of these
        os.sched_setaffinity(get_native_id(), {core})

    if cores > 1 and hasattr(os, "sched_setaffinity"):
        list(workers().map(pin, sorted(os.sched_getaffinity(0))[1:cores]))


def slowest_ms(lidar: SpinningSensor, poses: Floats, repetitions: int = 3) -> float:
    """Return the CPU time of the slowest scan from the poses, the least of the repetitions [ms]."""

    def milliseconds(pose: Floats) -> float:
        begin = time.thread_time()
        lidar.sector_ranges(pose)
        return 1e3 * (time.thread_time() - begin)

    lidar_module.usable_cores = lambda: 1
    return max(min(milliseconds(pose[None]) for _ in range(repetitions)) for pose in poses)


def building_s(lidar: SpinningSensor) -> float:
    """Return the CPU time in which the tables of a harbor are built, by code that is already compiled [s]."""
    radius = needed_radii(lidar._tables[0]).max()
    lidar._build_grid(radius)
    begin = time.thread_time()
    lidar._build_grid(radius)
    return time.thread_time() - begin


def megabytes(arrays: tuple[NDArray[np.generic], ...]) -> float:
    return sum(array.nbytes for array in arrays) / 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    loaded = load("s3")
    marina = build_worlds(loaded.scenario, loaded.base_dir)[0]
    lidar = marina.lidar
    lidar.sector_ranges(np.zeros((1, 3)))
    rng, cores = np.random.default_rng(0), lidar_module.usable_cores()
    fairway, berth, few = rng.uniform(*FAIRWAY, (500, 3)), rng.uniform(*BERTH, (500, 3)), 10
    embree = embree_scanner(lidar)
    report = bench.Report(
        "lidar", f"Full scans: {len(lidar.rays.reach):,} rays, {len(lidar.triangles):,} triangles"
    )
    report.seconds = bench.alternate(
        {
            EMBREE: bench.Case(lambda: [embree(pose) for pose in fairway[:few]], few),
            REFERENCE: bench.Case(lambda: lidar.sector_ranges_by_full_scan(fairway[:few]), few),
            SCAN: scans(lidar, fairway, 1),
            BERTHING: scans(lidar, berth, 1),
        },
        arguments.rounds,
        "one core",
    )
    pin_threads(cores)
    wall_clock = bench.alternate(
        {
            ONE_CORE: bench.Case(scans(lidar, fairway, 1).work, len(fairway), cores),
            ALL_CORES: scans(lidar, fairway, cores),
        },
        arguments.rounds,
        "all cores",
    )
    report.seconds |= wall_clock

    table, grid, _ = lidar._tables
    x_min, y_min, x_max, y_max = marina.obstacles.harbor.bounds
    basin = rng.uniform((x_min, y_min, -np.pi), (x_max, y_max, np.pi), (10_000, 3))
    free = basin[~marina.obstacles.blocked(basin)]
    report.facts = {
        "rays": len(lidar.rays.reach),
        "triangles": len(lidar.triangles),
        "rays_mb": megabytes(table),
        "harbor_mb": megabytes(grid),
    }
    report.targets = [
        bench.Target(SPEED, bench.ratio(report.seconds, EMBREE, SCAN), at_least=20, unit="×"),
        bench.Target(
            f"speed of scans on {cores} cores, relative to one",
            bench.ratio(wall_clock, ONE_CORE, ALL_CORES),
            at_least=0.85 * cores,
            unit="×",
        ),
        bench.Target(
            "a scan in the fairway", 1e3 * statistics.median(report.seconds[SCAN]), at_most=0.25, unit="ms"
        ),
        bench.Target(
            f"slowest of {len(free):,} scans in the basin", slowest_ms(lidar, free), at_most=5, unit="ms"
        ),
        bench.Target("grid of a harbor", report.facts["harbor_mb"], at_most=10, unit="MB"),
        bench.Target("grid of a harbor, built in", building_s(lidar), at_most=2, unit="s"),
    ]
    report.write()


if __name__ == "__main__":
    main()
