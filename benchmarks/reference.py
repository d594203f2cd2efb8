"""The fast scan compared with the reference implementation, bit for bit, and with embree.

    python benchmarks/reference.py                   # 500 poses
    python benchmarks/reference.py --poses 10000     # 15 minutes on one core

Poses are anywhere in the basin: in the fairway, in berths, inside moored vessels, piers and piles.
"""

from __future__ import annotations

import argparse
from concurrent.futures import ThreadPoolExecutor

import bench  # before numpy
import numpy as np
from lidar import embree_scanner
from rich.progress import track

from dockctl.compute import usable_cores
from dockctl.scenarios.loader import load
from dockctl.sim.world import build_worlds

BASIN = ((4.5, -40.0, -np.pi), (38.5, 40.0, np.pi))
BLOCK = 20
EMBREE_POSES = 200


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--poses", type=int, default=500)
    arguments = parser.parse_args()
    loaded = load("s3")
    world = build_worlds(loaded.scenario, loaded.base_dir)[0]
    lidar = world.lidar
    lidar.sector_ranges(np.zeros((1, 3)))
    poses = np.random.default_rng(0).uniform(*BASIN, (arguments.poses, 3))
    fast, touching = lidar.sector_ranges(poses), world.obstacles.blocked(poses)
    lidar.sector_ranges_by_full_scan(poses[:1])  # builds the tree before the threads need it
    blocks = np.array_split(poses, max(1, len(poses) // BLOCK))
    with ThreadPoolExecutor(usable_cores()) as pool:
        scanned = pool.map(lidar.sector_ranges_by_full_scan, blocks)
        shown = track(scanned, "reference", len(blocks), console=bench.console, transient=True)
        plain = np.concatenate(list(shown))
    embree = embree_scanner(lidar)
    peer = np.array([embree(pose) for pose in poses[:EMBREE_POSES]])
    report = bench.Report(
        "reference", f"The fast scan and the reference implementation, {len(poses):,} poses"
    )
    report.facts = {
        "poses": len(poses),
        "touching": int(touching.sum()),
        "ranges_compared": fast.size,
        "embree_off_mm": 1e3 * float(np.abs(peer - plain[: len(peer)]).max()),
    }
    report.targets = [
        bench.Target(f"different ranges, of {fast.size:,}", int(np.sum(fast != plain)), at_most=0),
        bench.Target("largest difference of embree", report.facts["embree_off_mm"], at_most=1, unit="mm"),
    ]
    report.write()


if __name__ == "__main__":
    main()
