"""Scaling: the time of a scan over rays, triangles and sectors, and of a step over harbors.

    python benchmarks/growth.py

Rays: the four LiDARs have more or fewer firings per revolution. Triangles: each one is divided into four,
repeatedly, so that the scene is the same. Poses are in the fairway. The comparison is embree. Harbors:
generated layouts of `marinas`, all in use. One core.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import tempfile
from collections.abc import Iterable
from typing import Any
from unittest.mock import patch

import bench  # before numpy
import numpy as np
import psutil
from lidar import FAIRWAY, embree_scanner, megabytes, scans
from numpy.typing import NDArray

from dockctl.envs.vector import DockingVectorEnv
from dockctl.scenarios.loader import load
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from dockctl.sim.world import build_worlds

AZIMUTH_STEPS = (225, 450, 900, 1800, 3600, 7200)
CUTS = (0, 1, 2)
SECTORS = (4, 8, 16, 32, 64)
HARBORS = (1, 4, 16, 64)
BOATS = 64
EMBREE_POSES = 4


def quartered(triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Divide each of (m, 3, 3) triangles at the midpoints of its edges: (4 m, 3, 3)."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(corners, axis=1) for corners in parts])


def point(lidar: SpinningSensor, rounds: int, what: str) -> dict[str, Any]:
    """Measure one set of sensors in one harbor."""
    poses = np.random.default_rng(0).uniform(*FAIRWAY, (300, 3))
    embree = embree_scanner(lidar)
    cases = {
        "dockctl": scans(lidar, poses, 1),
        "peer": bench.Case(lambda: [embree(pose) for pose in poses[:EMBREE_POSES]], EMBREE_POSES),
    }
    times = bench.alternate(cases, rounds, what)
    table, grid, _ = lidar._tables
    return {
        "rays": len(lidar.rays.reach),
        "triangles": len(lidar.triangles),
        "sectors": lidar.spec.sectors,
        "rays_mb": megabytes(table),
        "harbor_mb": megabytes(grid),
        **{name: bench.summary(seconds) for name, seconds in times.items()},
    }


def in_harbors(harbors: int, rounds: int) -> dict[str, Any]:
    """Measure a step of all boats, spread over some layouts, and the memory."""
    before = psutil.Process().memory_info().rss
    loaded = load("marinas", overrides=[f"harbor.layouts={harbors}"])
    env = DockingVectorEnv(loaded, BOATS, exploring=True)
    env.simulator.prepare(range(harbors))
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(env.single_action_space.n, size=(20, BOATS))
    case = bench.Case(lambda: [env.step(action) for action in actions], actions.size)
    times = bench.alternate({"step": case}, rounds, "harbors")
    used = psutil.Process().memory_info().rss - before
    return {"harbors": harbors, "memory_mb": used / 1e6, "step": bench.summary(times["step"])}


def exponent(points: list[dict[str, Any]], size: str) -> float:
    """Return the exponent of the time of dockctl over a size, by least squares."""
    x = np.log([one[size] for one in points])
    y = np.log([one["dockctl"]["median"] for one in points])
    return float(np.polyfit(x, y, 1)[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    loaded = load("s3")
    triangles = build_worlds(loaded.scenario, loaded.base_dir)[0].lidar.triangles
    spec = loaded.scenario.sensors.lidar
    report = bench.Report("growth", "Scaling")
    with tempfile.TemporaryDirectory() as folder, patch.dict(os.environ, XDG_CACHE_HOME=folder):
        # These tables need not be cached.
        def varied(key: str, values: Iterable[int], what: str) -> list[dict[str, Any]]:
            specs = (spec.model_copy(update={key: value}) for value in values)
            return [point(SpinningSensor(each, triangles), arguments.rounds, what) for each in specs]

        rays = varied("azimuth_steps", AZIMUTH_STEPS, "rays")
        sectors = varied("sectors", SECTORS, "sectors")
        scenes = [triangles]
        for _ in CUTS[1:]:
            scenes.append(quartered(scenes[-1]))
        cuts = [point(SpinningSensor(spec, scene), arguments.rounds, "triangles") for scene in scenes]
    with multiprocessing.get_context("spawn").Pool(1, maxtasksperchild=1) as process:
        # Each in its own process, so that the memory of other cases is not counted.
        harbors = [process.apply(in_harbors, (count, arguments.rounds)) for count in HARBORS]
    report.facts = {
        "rays": rays, "triangles": cuts, "sectors": sectors, "harbors": harbors, "boats": BOATS
    }  # fmt: skip
    report.targets = [
        bench.Target("exponent of the time of a scan over the rays", exponent(rays, "rays"), at_most=1),
        bench.Target(
            "exponent of the time of a scan over the triangles", exponent(cuts, "triangles"), at_most=0.5
        ),
        bench.Target("64 harbors in one training", harbors[-1]["memory_mb"] / 1e3, at_most=3, unit="GB"),
    ]
    report.write()


if __name__ == "__main__":
    main()
