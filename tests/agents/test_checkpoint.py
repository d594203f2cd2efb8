"""Checkpoints: round trip, where they are found, and what is wrong with bad ones."""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from dockctl.agents.checkpoint import (
    CheckpointError,
    PolicyCard,
    find_policy,
    load_policy,
    require_shape,
    save_policy,
)
from dockctl.agents.dqn.network import DuelingQNetwork
from dockctl.runs.files import new_folder
from dockctl.scenarios.interface import PolicyInterface
from dockctl.scenarios.loader import load

CARD = PolicyCard("toy", 4, 3, (8, 6), 1234, 7)


@pytest.fixture
def network() -> DuelingQNetwork:
    return DuelingQNetwork(4, 3, (8, 6), torch.Generator().manual_seed(1))


@pytest.fixture
def saved(tmp_path: Path, network: DuelingQNetwork) -> Path:
    with new_folder(tmp_path / "run" / "checkpoints" / "best") as folder:
        save_policy(folder, network, CARD)
    return tmp_path / "run" / "checkpoints" / "best"


@pytest.mark.parametrize("name", ["", "..", "../..", "policy.json", "policy.safetensors"])
def test_a_policy_is_found_by_run_folder_checkpoint_or_file(
    saved: Path, network: DuelingQNetwork, name: str
) -> None:
    if name == "..":
        with pytest.raises(CheckpointError, match="holds no checkpoint"):
            load_policy(saved / name)
        return
    loaded, card = load_policy(saved / name)
    assert (loaded.flat == network.flat).all()
    assert (card.scenario, card.env_steps, card.seed) == ("toy", 1234, 7)


def test_a_path_may_be_text(saved: Path) -> None:
    assert load_policy(str(saved))[1] == load_policy(saved)[1]


def test_the_interface_comes_back(tmp_path: Path, network: DuelingQNetwork) -> None:
    interface = PolicyInterface.of(load("s3").scenario)
    save_policy(tmp_path, network, replace(CARD, interface=interface))
    _, card = load_policy(tmp_path)
    assert card.interface == interface
    digest = hashlib.sha256((tmp_path / "policy.safetensors").read_bytes()).hexdigest()
    assert card == replace(CARD, interface=interface, sha256=digest)
    elsewhere = interface.on(load("s1").scenario)
    assert PolicyInterface.of(elsewhere) == interface
    assert (elsewhere.name, elsewhere.task) == ("s1", load("s1").scenario.task)


@pytest.fixture
def shelf(saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package that ships `berthing` and `toy`, and a folder to stand in."""
    for name in ("berthing", "toy"):
        shutil.copytree(saved, tmp_path / "shelf" / name)
    monkeypatch.setattr("dockctl.runs.directory.SHIPPED", tmp_path / "shelf")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    return tmp_path / "shelf"


def test_a_shipped_checkpoint_is_found_by_name(shelf: Path) -> None:
    assert find_policy(Path("toy")) == shelf / "toy" / "policy.json"
    with pytest.raises(CheckpointError, check=lambda error: error.suggestion == "berthing"):
        load_policy("berting")


def test_a_folder_goes_before_a_shipped_name(shelf: Path, saved: Path) -> None:
    shutil.copytree(saved, "toy")
    assert find_policy(Path("toy")) == Path("toy/policy.json")
    Path("berthing").mkdir()
    with pytest.raises(CheckpointError, match=f"holds no checkpoint.*the shipped 'berthing' is in {shelf}"):
        load_policy("berthing")


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
        save_policy(folder, network, PolicyCard("toy", 4, 3, (8, 6), 9999, 7))
    assert load_policy(saved)[1].env_steps == 9999
    assert [path.name for path in saved.parent.iterdir() if not path.name.startswith(".best.new")] == ["best"]


def break_it(saved: Path, how: str) -> None:
    tensors, card = saved / "policy.safetensors", saved / "policy.json"
    facts = json.loads(card.read_text())
    if how == "truncated":
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
    ("how", "message"),
    [
        ("truncated", "damaged or cut short"),
        ("empty", "damaged or cut short"),
        ("no json", "no such file"),
        ("no tensors", "no such file"),
        ("json cut", "not a readable checkpoint"),
        ("json list", "not a checkpoint of format"),
        ("format", "not a checkpoint of format"),
        ("missing fact", "does not describe a policy"),
        ("other sizes", "does not describe a policy"),
        ("nonsense size", "does not describe a policy"),
        ("nonsense interface", "does not describe a policy: interface.lidar_sectors: "),
    ],
)
def test_bad_checkpoints_get_one_message(saved: Path, how: str, message: str) -> None:
    break_it(saved, how)
    with pytest.raises(CheckpointError, match=message) as caught:
        load_policy(saved)
    assert "\n" not in str(caught.value)
    assert str(saved) in str(caught.value)


def test_nothing_there(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no such run folder or checkpoint"):
        load_policy(tmp_path / "nowhere")
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(CheckpointError, match="not a checkpoint"):
        load_policy(tmp_path / "notes.txt")
    with pytest.raises(CheckpointError, match="holds no checkpoint"):
        load_policy(tmp_path)


@pytest.mark.parametrize(("size", "actions", "what"), [(5, 3, "observation of 4"), (4, 77, "number of 3")])
def test_a_policy_for_something_else_is_refused(size: int, actions: int, what: str) -> None:
    require_shape(CARD, 4, 3, where=Path("p"), scenario="s1")
    with pytest.raises(CheckpointError, match=what):
        require_shape(CARD, size, actions, where=Path("p"), scenario="s1")
