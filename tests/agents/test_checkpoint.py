"""Checkpoints: round trip, where they are found, and what is wrong with bad ones."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box, Discrete, MultiDiscrete, Space

from dockctl import plugins
from dockctl.agents import checkpoint
from dockctl.agents.checkpoint import (
    CheckpointError,
    PolicyCard,
    find_policy,
    load_pair,
    load_policy,
    require_spaces,
    save_policy,
)
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.agents.interface import Spaces
from dockctl.agents.tensors import numpy_tensors
from dockctl.errors import PluginError
from dockctl.runs.files import new_folder
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import PolicyInterface

CARD = PolicyCard(scenario="toy", observation_size=4, actions=3, hidden_sizes=(8, 6), env_steps=1234, seed=7)


@pytest.fixture
def network() -> DuelingQNetwork:
    return DuelingQNetwork(4, 3, (8, 6), torch.Generator().manual_seed(1))


@pytest.fixture
def saved(tmp_path: Path, network: DuelingQNetwork) -> Path:
    with new_folder(tmp_path / "run" / "checkpoints" / "best") as folder:
        save_policy(folder, numpy_tensors(network.state_dict()), CARD)
    return tmp_path / "run" / "checkpoints" / "best"


@pytest.mark.parametrize("name", ["", "..", "../..", "policy.json", "policy.safetensors"])
def test_a_policy_is_found_by_run_folder_checkpoint_or_file(
    saved: Path, network: DuelingQNetwork, name: str
) -> None:
    if name == "..":
        with pytest.raises(CheckpointError) as caught:
            load_policy(saved / name)
        assert caught.value.code == "not_found"
        return
    loaded, card = load_policy(saved / name)
    observation = np.random.default_rng(0).normal(size=(50, 4))
    with torch.no_grad():
        best = network(torch.from_numpy(observation).float()).argmax(dim=1).numpy()
    np.testing.assert_array_equal(loaded.act(observation, {}), best)
    assert (card.scenario, card.env_steps, card.seed) == ("toy", 1234, 7)


PLUGIN = """\
from typing import Literal
from dockctl.agents.algorithms import AlgorithmSpec
from dockctl.plugins import ALGORITHMS
from dockctl.scenarios.extensions import register

@register(ALGORITHMS)
class Mine(AlgorithmSpec):
    kind: Literal["mine"] = "mine"
    def build(self, spaces, training, device): ...
    def load_policy(self, tensors, spaces, hidden_sizes):
        return tensors["weights of another version"]
"""


def test_a_plugin_that_cannot_load_its_policy_names_its_line(
    tmp_path: Path, network: DuelingQNetwork
) -> None:
    (tmp_path / "mine.py").write_text(PLUGIN)
    plugins.load_file(tmp_path / "mine.py")
    with new_folder(tmp_path / "policy") as folder:
        card = CARD.model_copy(update={"algorithm": {"kind": "mine"}})
        save_policy(folder, numpy_tensors(network.state_dict()), card)
    with pytest.raises(PluginError) as caught:
        load_policy(tmp_path / "policy")
    assert f"({tmp_path / 'mine.py'}:11)" in str(caught.value)


def test_a_path_may_be_text(saved: Path) -> None:
    assert load_policy(str(saved))[1] == load_policy(saved)[1]


def test_the_interface_comes_back(tmp_path: Path, network: DuelingQNetwork) -> None:
    interface = PolicyInterface.of(load("s3").scenario)
    saved = CARD.model_copy(update={"interface": interface})
    save_policy(tmp_path, numpy_tensors(network.state_dict()), saved)
    _, card = load_policy(tmp_path)
    assert card.interface == interface
    digest = hashlib.sha256((tmp_path / "policy.safetensors").read_bytes()).hexdigest()
    assert card == saved.model_copy(update={"sha256": digest})
    transferred = interface.on(load("s1").scenario)
    assert PolicyInterface.of(transferred) == interface
    assert (transferred.name, transferred.task) == ("s1", load("s1").scenario.task)


def test_a_policy_keeps_its_range_sensor() -> None:
    other = load("s1", overrides=["sensors.lidar.azimuth_steps=900", "sensors.lidar.sectors=12"]).scenario
    s3 = load("s3").scenario
    interface = PolicyInterface.of(other)
    assert interface.on(s3).sensors == other.sensors
    older = interface.model_copy(update={"lidar": None})
    lidar = older.on(s3).sensors.lidar
    assert lidar == s3.sensors.lidar.model_copy(update={"sectors": 12})
    finer = load("s3", overrides=["sensors.lidar.azimuth_steps=3600"]).scenario
    assert older.agrees(s3, finer) and not interface.agrees(s3, finer)
    assert interface.agrees(s3, s3)


@pytest.fixture
def shipped(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that ships `berthing` and `toy`; the working directory is empty."""
    for name in ("berthing", "toy"):
        shutil.copytree(saved, tmp_path / "shipped" / name)
    monkeypatch.setattr("dockctl.runs.directory.SHIPPED", tmp_path / "shipped")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "shipped"


def test_a_shipped_checkpoint_is_found_by_name(shipped: Path) -> None:
    assert find_policy(Path("toy")) == shipped / "toy" / "policy.json"
    with pytest.raises(CheckpointError, check=lambda error: error.suggestion == "berthing"):
        load_policy("berting")


def test_a_folder_takes_precedence_over_a_shipped_name(shipped: Path, saved: Path) -> None:
    shutil.copytree(saved, "toy")
    assert find_policy(Path("toy")) == Path("toy/policy.json")
    Path("berthing").mkdir()
    with pytest.raises(CheckpointError) as caught:
        load_policy("berthing")
    assert caught.value.code == "not_found"
    assert str(shipped / "berthing") in str(caught.value)


def test_a_pair_of_files_of_any_name(saved: Path, tmp_path: Path) -> None:
    for suffix in ("json", "safetensors"):
        (tmp_path / f"mine.{suffix}").write_bytes((saved / f"policy.{suffix}").read_bytes())
    assert load_policy(tmp_path / "mine.safetensors")[1].actions == 3


def test_a_new_checkpoint_replaces_the_old_one_only_when_complete(
    saved: Path, network: DuelingQNetwork
) -> None:
    before = (saved / "policy.json").read_bytes()

    def fail() -> None:
        with new_folder(saved) as folder:
            (folder / "policy.json").write_text("half")
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert (saved / "policy.json").read_bytes() == before
    with new_folder(saved) as folder:
        save_policy(folder, numpy_tensors(network.state_dict()), CARD.model_copy(update={"env_steps": 9999}))
    assert load_policy(saved)[1].env_steps == 9999
    assert [path.name for path in saved.parent.iterdir() if not path.name.startswith(".best.new")] == ["best"]


def break_it(saved: Path, how: str) -> None:
    tensors, card = saved / "policy.safetensors", saved / "policy.json"
    facts = {**json.loads(card.read_text()), "format": 1}  # without a hash of the facts
    if how == "changed":
        card.write_text(card.read_text().replace("1234", "1235"))
    elif how == "truncated":
        tensors.write_bytes(tensors.read_bytes()[:-100])
    elif how == "empty":
        tensors.write_bytes(b"")
    elif how == "no json":
        card.unlink()
    elif how == "no tensors":
        tensors.unlink()
    elif how == "json cut":
        card.write_text(card.read_text()[:40])
    elif how == "json list":
        card.write_text("[]")
    elif how == "format":
        card.write_text(json.dumps({**facts, "format": 99}))
    elif how == "missing fact":
        card.write_text(json.dumps({k: v for k, v in facts.items() if k != "actions"}))
    elif how == "other sizes":
        card.write_text(json.dumps({**facts, "hidden_sizes": [8, 7]}))
    elif how == "nonsense size":
        card.write_text(json.dumps({**facts, "observation_size": "four"}))
    elif how == "nonsense interface":
        given = {"observation": ["phase"], "lidar_sectors": 0, "actions": {}}
        card.write_text(json.dumps({**facts, "interface": given}))


@pytest.mark.parametrize(
    ("how", "file", "code"),
    [
        ("changed", "policy.json", "not_readable"),
        ("truncated", "policy.safetensors", "not_readable"),
        ("empty", "policy.safetensors", "not_readable"),
        ("no json", "policy.json", "not_found"),
        ("no tensors", "policy.safetensors", "not_found"),
        ("json cut", "policy.json", "not_readable"),
        ("json list", "policy.json", "not_readable"),
        ("format", "policy.json", "not_readable"),
        ("missing fact", "policy.json", "not_readable"),
        ("other sizes", "policy.json", "not_readable"),
        ("nonsense size", "policy.json", "not_readable"),
        ("nonsense interface", "interface.lidar_sectors", "not_readable"),
    ],
)
def test_bad_checkpoints_get_one_message(saved: Path, how: str, file: str, code: str) -> None:
    break_it(saved, how)
    with pytest.raises(CheckpointError) as caught:
        load_policy(saved)
    assert caught.value.code == code
    assert "\n" not in str(caught.value)
    assert str(saved) in str(caught.value)
    assert file in str(caught.value)


def test_nothing_there(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    for path, code in (("nowhere", "not_found"), ("notes.txt", "not_readable"), (".", "not_found")):
        with pytest.raises(CheckpointError) as caught:
            load_policy(tmp_path / path)
        assert caught.value.code == code


@pytest.mark.parametrize(
    ("size", "actions"), [(5, Discrete(3)), (4, Discrete(77)), (4, Box(-1, 1, (3,), np.float32))]
)
def test_a_policy_for_other_spaces_is_rejected(size: int, actions: Discrete | Box) -> None:
    def require(size: int, actions: Discrete | Box) -> None:
        spaces = Spaces(Box(-1, 1, (size,), np.float32), actions)
        require_spaces(CARD, spaces, where=Path("p"), scenario="s1")

    require(4, Discrete(3))
    with pytest.raises(CheckpointError) as caught:
        require(size, actions)
    assert caught.value.code == "mismatch"


def test_the_bounds_of_continuous_actions_come_back(tmp_path: Path) -> None:
    actions = Box(np.array([-1, -2], np.float32), np.array([1, 0.5], np.float32))
    spaces = Spaces(Box(-1, 1, (4,), np.float32), actions)
    card = PolicyCard.for_spaces(spaces, scenario="toy", seed=0)
    again = PolicyCard.model_validate_json(card.model_dump_json())
    assert again == card
    assert again.spaces.action == actions


@pytest.mark.parametrize(
    "actions",
    [
        Discrete(7, start=-3),
        MultiDiscrete([3, 5]),
        Box(-1, 1, (2,), np.float64),
        Box(-1, 1, (2, 2), np.float32),
        Box(0, 9, (2,), np.int64),
    ],
)
def test_actions_that_a_card_cannot_describe_are_refused(actions: Space[Any]) -> None:
    many = Box(-np.arange(40, dtype=np.float32), np.ones(40, np.float32))  # its text has several lines
    with pytest.raises(CheckpointError) as caught:
        PolicyCard.for_spaces(Spaces(many, actions), scenario="toy", seed=0)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["policy.json", "policy.safetensors"])
@pytest.mark.parametrize("how", ["gone", "torn", "changed"])
def test_a_damaged_policy_is_replaced_by_the_previous_one(
    saved: Path, name: str, how: str, caplog: pytest.LogCaptureFixture
) -> None:
    run, previous = saved.parent.parent, saved.with_name("best-1")
    shutil.copytree(saved, previous)
    assert find_policy(run) == saved / "policy.json"
    content = (saved / name).read_bytes()
    (saved / name).unlink()
    if how != "gone":
        middle = len(content) // 2
        rest = bytes([content[middle] ^ 1]) + content[middle + 1 :] if how == "changed" else b""
        (saved / name).write_bytes(content[:middle] + rest)
    assert find_policy(run) == previous / "policy.json"
    assert str(saved / name) in caplog.text
    assert str(previous) in caplog.text
    shutil.rmtree(previous)
    assert find_policy(run) == saved / "policy.json"  # the only one, for its error
    with pytest.raises(CheckpointError):
        load_policy(run)


@pytest.mark.parametrize("moment", [1, 2])
def test_a_policy_that_is_replaced_while_it_is_read_is_read_again(
    saved: Path, monkeypatch: pytest.MonkeyPatch, moment: int
) -> None:
    """A training that goes on moves the folder when it is first looked at, or before it is loaded."""
    reads: list[Path] = []

    def load_moving(file: Path) -> Any:
        reads.append(file)
        if len(reads) != moment:
            return load_pair(file)
        moved = saved.rename(saved.with_name("moved"))
        try:
            return load_pair(file)
        finally:
            moved.rename(saved)

    monkeypatch.setattr(checkpoint, "load_pair", load_moving)
    assert load_policy(saved.parent.parent)[1].env_steps == CARD.env_steps
