"""Checkpoints made to crash, to exhaust the memory or to mislead: one error each, and little memory."""

from __future__ import annotations

import hashlib
import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save

from dockctl.agents.checkpoint import CheckpointError, PolicyCard, load_policy
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.tensors import numpy_tensors
from dockctl.errors import DockctlError
from dockctl.evaluation import load_policy as load_any_policy
from dockctl.trust import UntrustedError
from tests.hostile.memory import at_most_mb

Tensors = dict[str, np.ndarray]
CARD = PolicyCard(scenario="s1", observation_size=15, actions=77, hidden_sizes=(8, 6), env_steps=9, seed=7)
DEEP = "[" * 100_000 + "]" * 100_000


def weights() -> Tensors:
    return numpy_tensors(DuelingQNetwork(15, 77, (8, 6)).state_dict())


def write(folder: Path, content: bytes, **changes: Any) -> Path:
    """Write a checkpoint of the first format, whose facts have no hash; the hash of the tensors is right."""
    facts = {"format": 1, **CARD.model_dump(mode="json"), "sha256": hashlib.sha256(content).hexdigest()}
    folder.mkdir(exist_ok=True)
    (folder / "policy.safetensors").write_bytes(content)
    (folder / "policy.json").write_text(json.dumps({**facts, **changes}))
    return folder


def test_the_unchanged_checkpoint_is_loaded(tmp_path: Path) -> None:
    policy, card = load_policy(write(tmp_path, save(weights())))
    assert policy.act(np.zeros((2, 15), np.float32), {}).shape == (2,)
    assert card.actions == 77


@pytest.mark.parametrize(
    "changes",
    [
        {"hidden_sizes": []},
        {"hidden_sizes": [0]},
        {"hidden_sizes": [-8, 6]},
        {"hidden_sizes": [8.5, 6]},
        {"hidden_sizes": [8, "6"]},
        {"hidden_sizes": [8192] * 16},
        {"hidden_sizes": [1_000_000, 1_000_000]},
        {"hidden_sizes": [10**30]},
        {"hidden_sizes": [1] * 100_000},
        {"observation_size": 0},
        {"observation_size": 1e12},
        {"observation_size": 10**12},
        {"observation_size": True},
        {"actions": 0},
        {"actions": -77},
        {"actions": 10**12},
        {"actions": "77"},
        {"env_steps": -1},
        {"seed": None},
        {"scenario": "../s1.yaml"},
        {"scenario": "\ud800"},
        {"scenario": "s" * 1000},
        {"algorithm": []},
        {"algorithm": {}},
        {"algorithm": {"kind": ["dqn"]}},
        {"algorithm": {"kind": "no such algorithm"}},
        {"algorithm": {"kind": "dqn", "more": 1}},
        {"algorithm": {"kind": "sb3", "model": "DQN", "hyperparameters": {"policy_kwargs": 3}}},
        {"hidden_sizes": [30_000, 30_000], "algorithm": {"kind": "sb3"}},
        {
            "algorithm": {
                "kind": "sb3",
                "hyperparameters": {"policy_kwargs": {"net_arch": [30_000, 30_000]}},
            }
        },
        {"action_bounds": [[0.0], [1.0, 2.0]]},
        {"action_bounds": [["low"], ["high"]]},
        {"action_bounds": [[0.0] * 77, [1.0] * 77]},
        {"interface": {"observation": [], "lidar_sectors": 8, "actions": {"kind": "grid"}}},
        {"interface": {"observation": ["phase"], "lidar_sectors": 10**9, "actions": {"kind": "grid"}}},
        {"interface": {"observation": ["phase"], "lidar_sectors": 8, "actions": {"kind": "nothing"}}},
        {"interface": 3},
        {"format": 99},
        {"sha256": None},
        {"sha256": "0" * 64},
    ],
    ids=lambda changes: str(changes)[:60],
)
def test_facts(tmp_path: Path, changes: dict[str, Any]) -> None:
    if "sb3" in str(changes):
        pytest.importorskip("stable_baselines3")
    folder = write(tmp_path, save(weights()), **changes)
    with at_most_mb(200), pytest.raises(CheckpointError) as caught:
        load_policy(folder)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_module_that_the_facts_name_is_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("stable_baselines3")
    (tmp_path / "hostile_module.py").write_text(f"open({str(tmp_path / 'marker')!r}, 'w')")
    monkeypatch.syspath_prepend(tmp_path)
    model = {"kind": "sb3", "model": "hostile_module:Model"}
    with pytest.raises(UntrustedError):
        load_any_policy(write(tmp_path / "policy", save(weights()), algorithm=model))
    assert not (tmp_path / "marker").exists()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\x00",
        "null",
        DEEP,
        '{"format": 1, "algorithm": ' + DEEP + "}",
        '{"format": 1, "algorithm": ' + "[" * 60 + "]" * 60 + "}",
        '{"format": 1, "env_steps": NaN}',
        '{"format": 1, "env_steps": -Infinity}',
        '{"format": 1, "env_steps": 1e999}',
        '{"format": 1, "env_steps": ' + "1" * 10_000 + "}",
        '{"format": 1, "sha256": "' + "0" * 10_000_000 + '"}',
    ],
    ids=lambda text: text[:40],
)
def test_text_of_the_facts(tmp_path: Path, text: str) -> None:
    folder = write(tmp_path, save(weights()))
    (folder / "policy.json").write_text(text)
    with at_most_mb(200), pytest.raises(CheckpointError):
        load_policy(folder)


def with_type(name: str, size: int) -> bytes:
    """Return tensors whose numbers are declared to have another type of `size` bytes."""
    header, data, start = {}, b"", 0
    for key, array in weights().items():
        end = start + array.size * size
        header[key] = {"dtype": name, "shape": list(array.shape), "data_offsets": [start, end]}
        data, start = data + bytes(array.size * size), end
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + data


def changed(change: Callable[[Tensors], Any]) -> bytes:
    tensors = weights()
    change(tensors)
    return save(tensors)


HEADER = b'{"a":{"dtype":"F32","shape":[%d],"data_offsets":[0,%d]}}'
TENSORS = {
    "BF16": lambda: with_type("BF16", 2),
    "F8": lambda: with_type("F8_E4M3", 1),
    "F4": lambda: with_type("F4", 1),
    "unknown type": lambda: with_type("X9", 1),
    "NaN": lambda: changed(lambda t: t["value.0.weight"].__setitem__((0, 0), np.nan)),
    "infinity": lambda: changed(lambda t: t["advantage.2.bias"].__setitem__(5, -np.inf)),
    "one missing": lambda: changed(lambda t: t.pop("value.0.bias")),
    "one more": lambda: changed(lambda t: t.update(more=np.zeros(3, np.float32))),
    "transposed": lambda: changed(lambda t: t.update({"value.0.weight": np.zeros((3, 12), np.float32)})),
    "none": lambda: save({}),
    "empty": lambda: b"",
    "header longer than the file": lambda: struct.pack("<Q", 10**9) + b"{}",
    "header of 2^63 bytes": lambda: struct.pack("<Q", 2**63) + b"{}",
    "deep header": lambda: struct.pack("<Q", len(DEEP)) + DEEP.encode(),
    "shape of 10^12": lambda: struct.pack("<Q", 200) + (HEADER % (10**12, 4 * 10**12)).ljust(200),
}


@pytest.mark.parametrize("name", TENSORS)
def test_tensors(tmp_path: Path, name: str) -> None:
    folder = write(tmp_path, TENSORS[name]())
    with at_most_mb(200), pytest.raises(CheckpointError) as caught:
        load_policy(folder)
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["policy.json", "policy.safetensors"])
@pytest.mark.parametrize("kind", ["larger than the memory", "pipe", "folder", "link to a device"])
def test_what_is_no_ordinary_file(tmp_path: Path, name: str, kind: str) -> None:
    folder = write(tmp_path / "policy", save(weights()))
    (folder / name).unlink()
    if kind == "larger than the memory":
        with (folder / name).open("wb") as file:
            file.truncate(2**42)  # a sparse file, which takes no disk space
    elif kind == "pipe":
        os.mkfifo(folder / name)
    elif kind == "folder":
        (folder / name).mkdir()
    else:
        (folder / name).symlink_to("/dev/zero")
    with at_most_mb(50), pytest.raises(DockctlError):
        load_policy(folder)


@pytest.mark.parametrize(
    "interface",
    [
        {"observation": ["phase"], "lidar_sectors": 8, "actions": {"kind": "grid"}},
        {"observation": ["no such part"], "lidar_sectors": 8, "actions": {"kind": "grid"}},
        {"observation": [{"phase": {"no": 1}}], "lidar_sectors": 8, "actions": {"kind": "grid"}},
        {"observation": [{"part": "phase", "params": {"a": []}}], "lidar_sectors": 8, "actions": {}},
    ],
    ids=str,
)
def test_an_interface_that_does_not_fit_the_network(tmp_path: Path, interface: dict[str, Any]) -> None:
    folder = write(tmp_path, save(weights()), interface=interface)
    with pytest.raises(DockctlError):
        _run(folder)


def _run(folder: Path) -> None:
    from dockctl.evaluation import Rollout

    policy = load_any_policy(folder)
    rollout = Rollout(policy.scenario())
    policy.make(rollout.env())
