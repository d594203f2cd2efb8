"""How the cost of a scan grows with the number of rays and of triangles, beside embree's.

    python benchmarks/growth.py

Rays: the four LiDARs fire more or fewer times a turn. Triangles: each of the marina's is cut into four,
and again, so that the scene stays the same. Poses lie in the fairway; one core.
"""

from __future__ import annotations

import argparse
import os
import tempfile

import bench  # before numpy
import numpy as np
from lidar import FAIRWAY, embree_scanner, megabytes, scans
from numpy.typing import NDArray

from dockctl.scenarios.loader import load
from dockctl.sim.lidar import LidarArray
from dockctl.sim.simulator import build_worlds

AZIMUTH_STEPS = (225, 450, 900, 1800, 3600, 7200)
CUTS = (0, 1, 2)
EMBREE_POSES = 4


def quartered(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cut each of (m, 3, 3) triangles at the middles of its edges: (4 m, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(corners, axis=1) for corners in parts])


def point(lidar: LidarArray, rounds: int, what: str) -> dict[str, object]:
    """Measure one set of sensors in one harbor."""
    poses = np.random.default_rng(0).uniform(*FAIRWAY, (300, 3))
    embree = embree_scanner(lidar)
    cases = {
        "dockctl": scans(lidar, poses, 1),
        "embree": bench.Case(lambda: [embree(pose) for pose in poses[:EMBREE_POSES]], EMBREE_POSES),
    }
    times = bench.alternate(cases, rounds, what)
    table, grid, _ = lidar._tables
    return {
        "rays": len(lidar.rays.reach),
        "triangles": len(lidar.triangles),
        "rays_mb": megabytes(table),
        "harbor_mb": megabytes(grid),
        **{name: bench.summary(seconds) for name, seconds in times.items()},
    }


def exponent(points: list[dict[str, object]], size: str) -> float:
    """Return the exponent with which the time of a scan grows with a size, by least squares."""
    x = np.log([float(str(one[size])) for one in points])
    y = np.log([one["dockctl"]["median"] for one in points])  # type: ignore[index]
    return float(np.polyfit(x, y, 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    loaded = load("s3")
    triangles = build_worlds(loaded.scenario, loaded.base_dir)[0].lidar.triangles
    spec = loaded.scenario.sensors.lidar
    report = bench.Report("growth", "How the cost of a scan grows")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = folder  # these tables are nobody's to keep
        rays = [
            point(
                LidarArray(spec.model_copy(update={"azimuth_steps": steps}), triangles),
                arguments.rounds,
                "rays",
            )
            for steps in AZIMUTH_STEPS
        ]
        scenes = [triangles]
        for _ in CUTS[1:]:
            scenes.append(quartered(scenes[-1]))
        cuts = [point(LidarArray(spec, scene), arguments.rounds, "triangles") for scene in scenes]
    report.facts = {"rays": rays, "triangles": cuts}
    report.bars = [
        bench.Bar("exponent of the cost in rays", exponent(rays, "rays"), at_most=1),
        bench.Bar("exponent of the cost in triangles", exponent(cuts, "triangles"), at_most=0.5),
    ]
    report.tell()


if __name__ == "__main__":
    main()
