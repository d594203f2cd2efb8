"""The estimate of a training's memory against what the parts take, and the memory that is available."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from dockctl.agents.dqn.compiled import DoubleDQN
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.errors import DockctlError
from dockctl.experiments import memory
from dockctl.experiments.memory import available_bytes, estimate, held_bytes, network_size, require_memory
from dockctl.scenarios.loader import load
from dockctl.scenarios.training import Training
from dockctl.sim.lidar.array import LidarArray
from dockctl.sim.world import build_worlds


def sizes(**training: object) -> dict[str, int]:
    loaded = load("s1", overrides=[f"training.{name}={value}" for name, value in training.items()])
    parts = estimate(loaded.scenario, build_worlds(loaded.scenario, loaded.base_dir)).parts
    return {part.name: part.size for part in parts}


def test_the_default_training_takes_less_than_a_gigabyte_and_a_half() -> None:
    loaded = load("s3")
    needed = estimate(loaded.scenario, build_worlds(loaded.scenario, loaded.base_dir))
    assert 0.2e9 < needed.to_come < 0.7e9
    assert needed.peak == needed.to_come + needed.held
    assert str(needed).startswith(f"{needed.peak / 1e9:.1f} GB at its peak (libraries and harbor")


def test_the_tables_take_what_is_estimated() -> None:
    loaded = load("s1")
    (world,) = build_worlds(loaded.scenario, loaded.base_dir)
    assert isinstance(world.lidar, LidarArray)
    arrays = [array for table in world.lidar._tables for array in table if isinstance(array, np.ndarray)]
    taken = sum(array.nbytes for array in arrays)
    assert world.lidar.table_bytes == pytest.approx(taken, rel=0.25)


def test_the_replay_is_as_long_as_the_training_at_most() -> None:
    assert sizes(total_steps=1000)["replay"] == 1000 * (16 + 8 * 15)
    assert sizes(replay_capacity=700)["replay"] == 700 * (16 + 8 * 15)


@pytest.mark.parametrize("hidden_sizes", [(8,), (256, 128, 64)])
def test_the_networks_size_is_counted_as_it_is(hidden_sizes: tuple[int, ...]) -> None:
    network = DuelingQNetwork(15, 77, hidden_sizes)
    work = DoubleDQN(network, Training(batch_size=2))._work
    outputs = sum(output.shape[1] for output in work.target)
    parameters, counted = network_size(15, 77, hidden_sizes)
    assert parameters == len(network.flat)
    assert counted == outputs + 1 + 77


def test_larger_settings_take_more() -> None:
    before = sizes()
    for field, value, parts in (
        ("boats", 512, {"boats"}),
        ("batch_size", 4096, {"batches"}),
        ("hidden_sizes", "[1024, 1024]", {"networks", "batches"}),
    ):
        after = sizes(**{field: value})
        assert {name for name in after if after[name] > before[name]} == parts


def test_what_does_not_fit_is_refused_by_the_field_that_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 10**9)
    loaded = load("s1", overrides=["training.hidden_sizes=[8192, 8192, 8192]"])
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    with pytest.raises(DockctlError) as caught:
        require_memory(loaded.scenario, worlds)
    assert caught.value.message.startswith("training.hidden_sizes: ")
    assert caught.value.code == "unavailable"


def test_this_process_holds_some_memory_and_the_machine_has_some() -> None:
    assert 10e6 < held_bytes() < 100e9
    assert available_bytes() > 0


def a_machine(root: Path, group: str, files: dict[str, str]) -> Path:
    contents = {
        "proc/meminfo": "MemTotal: 9000 kB\nMemAvailable: 8000 kB\n",
        "proc/self/cgroup": group,
        **files,
    }
    for name, content in contents.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return root


def test_without_limits_what_the_machine_has(tmp_path: Path) -> None:
    machine = a_machine(tmp_path, "0::/a\n", {"sys/fs/cgroup/a/memory.max": "max\n"})
    assert available_bytes(machine) == 8000 * 1024


@pytest.mark.parametrize("limited", ["", "a/", "a/b/"])
def test_a_limited_group_of_version_2(limited: str, tmp_path: Path) -> None:
    """Of the process itself or of one around it; cached files do not count."""
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
