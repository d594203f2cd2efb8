"""The checkpoints of the package: the files of their cards, and that each still docks."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import pytest

from dockctl.evaluation import load_policy
from dockctl.evaluation.rollout import Rollout
from dockctl.evaluation.starts import evaluation_starts, training_starts
from dockctl.experiments.export import CARD
from dockctl.geometry import pose_label
from dockctl.run_files import POLICY_JSON, POLICY_TENSORS, SCENARIO
from dockctl.runs.directory import shipped
from dockctl.scenarios.content import first_difference
from dockctl.scenarios.loader import load
from tests.commands.conftest import dockctl

NAMES = {"s1", "s2", "s3", "s3-direct", "marina", "marina-smooth", "marinas", "marinas-weather"}
EPISODES = {"marina": (4, 4), "marina-smooth": (4, 4), "marinas": (3, 3), "marinas-weather": (16, 12)}
"""How many starts of its training are tried, and how many must dock; one where nothing stands here."""

NAMED = sorted(shipped())
each = pytest.mark.parametrize("name", NAMED)


def test_there_is_one_for_each_scenario_and_the_list_shows_them() -> None:
    assert set(shipped()) == NAMES
    lines = dockctl("list", "checkpoints").out.splitlines()
    assert {line.split("\t")[1] for line in lines[1:]} == NAMES


@each
def test_the_files_are_those_of_the_card(name: str) -> None:
    folder = shipped()[name]
    text = (folder / CARD).read_text()
    listed = dict(re.findall(r"^\| `([^`]+)` \| `([0-9a-f]{64})` \|$", text, re.M))
    there = {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file() and path.name != CARD
    }
    assert listed == there
    assert {POLICY_JSON, POLICY_TENSORS, SCENARIO} <= set(listed)


@each
def test_it_was_trained_on_the_scenario_as_it_stands(name: str) -> None:
    """The learner may have other defaults today; its scenario.yaml has those of the training."""
    theirs = load(str(load_policy(name).own_scenario)).scenario
    assert first_difference(load(name).scenario, theirs, ignore=("training",)) is None


@pytest.mark.parametrize(
    "name",
    [
        # these build 80 layouts
        pytest.param(name, marks=[pytest.mark.thorough] if name in ("marinas", "marinas-weather") else [])
        for name in NAMED
    ],
)
def test_it_docks_from_starts_of_its_training(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    policy = load_policy(name)
    rollout = Rollout(policy.scenario())
    loaded, worlds = rollout.loaded, rollout.worlds
    starts = evaluation_starts if loaded.scenario.task.berths else training_starts
    tried, least = EPISODES.get(name, (1, 1))
    some = starts(loaded.scenario, worlds)[:tried]
    played = rollout.run(policy.make(rollout.env()), some)
    assert sum(one.docked for one in played) >= least


@each
def test_its_card_names_it_as_any_folder_knows_it(name: str) -> None:
    assert re.findall(r"^dockctl .*", (shipped()[name] / CARD).read_text(), re.M) == [
        f"dockctl evaluate {name}"
    ]


@each
def test_its_card_writes_poses_as_everything_does(name: str) -> None:
    text = (shipped()[name] / CARD).read_text()
    for numbers in re.findall(r"\(([^()]*)°\)", text):
        x, y, heading = (float(number.replace("−", "-")) for number in numbers.split(","))
        assert pose_label(x, y, heading) == f"({numbers}°)"
