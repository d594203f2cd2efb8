"""Harbors in memory: one of each while it is used, and a limit for those that are not."""

from __future__ import annotations

import gc
from pathlib import Path
from weakref import ref

import pytest

from dockctl import compute
from dockctl.evaluation import starts
from dockctl.evaluation.rollout import Rollout
from dockctl.scenarios.harbor import Marina
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from dockctl.sim import world
from dockctl.sim.harbor.build import Harbor, build_harbor
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.world import World, build_worlds
from tests.evaluation.test_rollout import Rest

QUAYS = (
    "harbor={name: quays, basin: {x_min_m: 0, x_max_m: 60, y_min_m: -20, y_max_m: 20},"
    " rows: [{side: east, berth_y_m: [0], free_y_m: [0]}]}"
)


LAYOUTS = ("harbor.layouts=3", "harbor.held_out_layouts=1", "sensors={lidar: {kind: planar, rays: 4}}")


def harbors(count: int) -> list[Scenario]:
    """Return scenarios in equal harbors, each with its own specification."""
    planar = "sensors={lidar: {kind: planar, rays: 4}}"
    scenario = load("s1", overrides=[QUAYS, planar]).scenario
    specs = [scenario.harbor.model_copy(update={"name": f"harbor {i}"}) for i in range(count)]
    return [scenario.model_copy(update={"harbor": spec}) for spec in specs]


def test_a_harbor_is_built_once_while_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compute, "UNUSED_BYTES", 0)
    one, other = harbors(2)
    (first,) = build_worlds(one, Path())
    build_worlds(other, Path())
    assert build_worlds(one, Path())[0] is first
    assert build_worlds(one, Path.cwd())[0] is first  # it has no mesh files


def test_only_harbors_that_are_used_are_built(monkeypatch: pytest.MonkeyPatch) -> None:
    built: list[str] = []

    def build(spec: Marina, base_dir: Path) -> Harbor:
        built.append(spec.name)
        return build_harbor(spec, base_dir)

    monkeypatch.setattr(world, "build_harbor", build)
    loaded = load("marinas", overrides=LAYOUTS)
    scenario, rollout = loaded.scenario, Rollout(loaded)
    site = own_site(scenario)
    start = given_start(site, scenario.task, site.initial[0], 0)
    rollout.at_start(start)
    rollout.run(Rest(), [start])
    assert built == ["generated-0"]
    assert starts.testing_starts(scenario, rollout.worlds, 0, seed=0) == []
    assert {start.harbor for start in starts.testing_starts(scenario, rollout.worlds, 2, seed=0)} == {3}
    assert built == ["generated-0", "generated-1000000"]
    rollout.env().reset(seed=0)
    assert built == ["generated-0", "generated-1000000", "generated-1", "generated-2"]


def test_harbors_that_are_not_used_take_a_limited_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    def alive(limit: int) -> int:
        monkeypatch.setattr(compute, "UNUSED_BYTES", limit)
        worlds: list[ref[World]] = [ref(build_worlds(scenario, Path())[0]) for scenario in scenarios]
        gc.collect()
        return sum(world() is not None for world in worlds)

    assert compute.UNUSED_BYTES <= 0.512e9
    scenarios = harbors(12)
    assert alive(10**12) == 12
    assert alive(0) == 0
    (harbor,) = (world.obstacles.harbor for world in build_worlds(scenarios[0], Path()))  # type: ignore[attr-defined]
    assert 1 <= alive(60 * harbor.triangles.nbytes) <= 5
