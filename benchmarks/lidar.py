"""The LiDAR scan against the usual way to scan a mesh (trimesh with embree), and against its oracle.

    python benchmarks/lidar.py                    # ratios, and the oracle on 2,000 poses of the basin
    python benchmarks/lidar.py --poses 200        # a quick look

Every round times all the candidates one after the other; the table shows the median of the rounds. Poses of
the fairway lie between the rows of berths; poses of the check lie anywhere in the basin, inside berths and
across moored vessels and piers too.
"""

from __future__ import annotations

import argparse
import platform
import statistics
import time
from collections.abc import Callable
from importlib.metadata import version

import numpy as np
import trimesh
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table
from trimesh.ray.ray_pyembree import RayMeshIntersector

from dockctl.scenarios.loader import load
from dockctl.sim import lidar as lidar_module
from dockctl.sim.lidar import LidarArray
from dockctl.sim.simulator import build_world

Floats = NDArray[np.float64]

FAIRWAY = ((14.5, -14.0, -np.pi), (27.0, 14.0, np.pi))
BASIN = ((4.5, -40.0, -np.pi), (38.5, 40.0, np.pi))


def embree_scanner(lidar: LidarArray) -> Callable[[Floats], Floats]:
    """Return a scan of one pose by embree on trimesh's scene, with the sector ranges by numpy.

    The scene is asked for distances alone, which is faster than trimesh's own methods; `scale_to_box` would
    return distances in the units of a scaled copy.
    """
    corners = lidar.triangles.reshape(-1, 3)
    mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=False)
    intersector, rays, sectors = RayMeshIntersector(mesh, scale_to_box=False), lidar.rays, lidar.spec.sectors
    intersector.intersects_first([[0.0, 0.0, 50.0]], [[0.0, 0.0, -1.0]])  # builds the scene

    def scan(pose: Floats) -> Floats:
        c, s = np.cos(pose[2]), np.sin(pose[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        origins = (rays.origins @ turn.T + [pose[0], pose[1], 0.0]).astype(np.float32)
        directions = (rays.directions @ turn.T).astype(np.float32)
        distance = intersector._scene.run(origins, directions, query="DISTANCE")
        seen = distance <= rays.reach
        body = rays.origins[seen] + distance[seen, None] * rays.directions[seen]
        azimuth = np.arctan2(body[:, 1], body[:, 0])
        bins = np.minimum(((azimuth + np.pi) / (2 * np.pi) * sectors).astype(int), sectors - 1)
        ranges = np.full(sectors, lidar.spec.range_m)
        np.minimum.at(ranges, bins, np.hypot(body[:, 0], body[:, 1]))
        return ranges

    return scan


def seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def on_threads(count: int, lidar: LidarArray, poses: Floats) -> Callable[[], object]:
    def work() -> None:
        lidar_module.thread_count = lambda: count
        lidar.sector_ranges(poses)

    return work


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=2000, help="poses compared with the oracle")
    parser.add_argument("--rounds", type=int, default=5)
    arguments = parser.parse_args()
    loaded = load("s3")
    lidar = build_world(loaded.scenario, loaded.base_dir).lidar
    lidar.prepare()
    rng, console = np.random.default_rng(0), Console()
    fairway = rng.uniform(*FAIRWAY, (500, 3))
    few = fairway[:10]
    scan = embree_scanner(lidar)
    cores = lidar_module.thread_count()
    candidates: dict[str, tuple[int, Callable[[], object]]] = {
        "trimesh + embree + numpy, 1 core": (len(few), lambda: [scan(pose) for pose in few]),
        "every ray by the oracle, 1 core": (len(few), lambda: lidar.sector_ranges_by_full_scan(few)),
        "dockctl, 1 core": (len(fairway), on_threads(1, lidar, fairway)),
        f"dockctl, {cores} cores": (len(fairway), on_threads(cores, lidar, fairway)),
    }
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(arguments.rounds):
        for name, (count, work) in candidates.items():
            times[name].append(seconds(work) / count)
    medians = {name: statistics.median(values) for name, values in times.items()}
    slowest = medians["trimesh + embree + numpy, 1 core"]
    table = Table(
        title=f"Full scans in the fairway: {len(lidar.rays.reach):,} rays, {len(lidar.triangles):,} triangles"
    )
    for heading in ("way", "ms a scan", "scans a second", "times embree"):
        table.add_column(heading, justify="left" if heading == "way" else "right")
    for name, median in medians.items():
        table.add_row(name, f"{median * 1e3:.2f}", f"{1 / median:,.0f}", f"{slowest / median:.1f}")
    console.print(table)

    poses = rng.uniform(*BASIN, (arguments.poses, 3))
    fast = lidar.sector_ranges(poses)
    blocks = np.array_split(np.arange(len(poses)), max(1, len(poses) // 50))
    plain = np.concatenate(
        [lidar.sector_ranges_by_full_scan(poses[block]) for block in track(blocks, "oracle")]
    )
    peer = np.array([scan(pose) for pose in track(poses[:200], "embree")])
    off = np.abs(peer - plain[: len(peer)])
    console.print(
        f"oracle: {np.sum(fast != plain)} of {plain.size:,} ranges differ from the fast scan's in any bit"
    )
    console.print(
        f"embree: largest difference from the oracle {off.max() * 1e3:.4f} mm over {off.size:,} ranges"
    )
    libraries = ", ".join(f"{name} {version(name)}" for name in ("numpy", "numba", "trimesh", "embreex"))
    machine = platform.processor() or platform.machine()
    console.print(f"{machine}, {cores} cores, Python {platform.python_version()}, {libraries}")


if __name__ == "__main__":
    main()
