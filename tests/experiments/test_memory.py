"""The memory estimate of a training against real sizes, and the memory that is available."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dockctl.dueling import network_size
from dockctl.errors import DockctlError
from dockctl.experiments import memory
from dockctl.experiments.memory import available_bytes, estimate, require_memory
from dockctl.scenarios.loader import load
from dockctl.sim.lidar.spinning_sensor import SpinningSensor
from dockctl.sim.world import build_worlds


def sizes(**training: object) -> dict[str, int]:
    loaded = load("s1", overrides=[f"training.{name}={value}" for name, value in training.items()])
    parts = estimate(loaded.scenario, build_worlds(loaded.scenario, loaded.base_dir)).parts
    return {part.name: part.size for part in parts}


def test_the_default_training_needs_half_a_gigabyte() -> None:
    loaded = load("s3")
    estimated = estimate(loaded.scenario, build_worlds(loaded.scenario, loaded.base_dir))
    assert 0.2e9 < estimated.needed < 0.7e9
    assert 10e6 < estimated.resident < 100e9
    assert estimated.peak == estimated.needed + estimated.resident


@pytest.mark.parametrize(("name", "overrides"), [("s1", []), ("marinas", ["harbor.layouts=2"])])
def test_the_size_of_the_lidar_tables(name: str, overrides: list[str]) -> None:
    """The harbors share the table of rays, and each has its own grid."""
    loaded = load(name, overrides=overrides)
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    (estimated,) = (u for u in estimate(loaded.scenario, worlds).parts if u.name == "LiDAR tables")
    arrays = {
        id(array): array.nbytes
        for world in worlds
        if isinstance(world.lidar, SpinningSensor)
        for table in world.lidar._tables
        for array in table
        if isinstance(array, np.ndarray)
    }
    assert estimated.size == pytest.approx(sum(arrays.values()), rel=0.25)


def test_the_replay_is_no_longer_than_the_training() -> None:
    assert sizes(total_steps=1000)["replay"] == 1000 * (16 + 8 * 15)
    assert sizes(replay_capacity=700)["replay"] == 700 * (16 + 8 * 15)


def test_the_size_of_the_network() -> None:
    # Layers 15-8, the value 8-8-1 and the advantage 8-77-77, each output with a bias.
    parameters = 16 * 8 + 9 * 8 + 9 * 1 + 9 * 77 + 78 * 77
    assert network_size(15, 77, (8,)) == (parameters, 8 + 8 + 1 + 77 + 77)
    assert network_size(15, 77, (256, 128, 64)) == (60_484, 256 + 128 + 64 + 64 + 1 + 77 + 77)


def test_larger_settings_need_more() -> None:
    before = sizes()
    for field, value, parts in (
        ("boats", 512, {"boats"}),
        ("batch_size", 4096, {"batches"}),
        ("hidden_sizes", "[1024, 1024]", {"networks", "batches"}),
    ):
        after = sizes(**{field: value})
        assert {name for name in after if after[name] > before[name]} == parts


def test_the_error_names_the_field_that_needs_most(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 10**9)
    loaded = load("s1", overrides=["training.hidden_sizes=[8192, 8192, 8192]"])
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    with pytest.raises(DockctlError) as caught:
        require_memory(loaded.scenario, worlds)
    assert caught.value.code == "unavailable"
    assert str(caught.value).startswith("training.hidden_sizes:")


def a_machine(root: Path, group: str, files: dict[str, str]) -> Path:
    for name, content in {"proc/self/cgroup": group, **files}.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return root


def test_without_limits_the_machine_counts(tmp_path: Path) -> None:
    files = {"memory.max": "max\n", "memory.current": "3000\n", "memory.stat": "inactive_file 500\n"}
    tree = {f"sys/fs/cgroup/a/{name}": text for name, text in files.items()}
    machine = a_machine(tmp_path, "0::/a\n", tree)
    assert available_bytes(machine) > 1e6


@pytest.mark.parametrize("limited", ["", "a/", "a/b/"])
def test_a_limited_group_of_version_2(limited: str, tmp_path: Path) -> None:
    """The limit of the group or of a parent; the page cache can be freed."""
    files = {"memory.max": "5000\n", "memory.current": "3000\n", "memory.stat": "anon 7\ninactive_file 500\n"}
    tree = {f"sys/fs/cgroup/{limited}{name}": content for name, content in files.items()}
    assert available_bytes(a_machine(tmp_path, "0::/a/b\n", tree)) == 2500


def test_a_limited_group_of_version_1(tmp_path: Path) -> None:
    base = "sys/fs/cgroup/memory/x"
    files = {
        f"{base}/memory.limit_in_bytes": "6000",
        f"{base}/memory.usage_in_bytes": "1000",
        f"{base}/memory.stat": "inactive_file 0\n",
    }
    assert available_bytes(a_machine(tmp_path, "3:cpu:/x\n4:memory,foo:/x\n", files)) == 5000
