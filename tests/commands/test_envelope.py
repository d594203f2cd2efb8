"""``dockctl envelope``: counts, equal starts, files, the card, errors."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pandas as pd
import pytest

from dockctl.evaluation import load_policy
from dockctl.evaluation.envelope import FACTORS
from dockctl.experiments.export import export_checkpoint
from dockctl.runs.tables import ENVELOPE
from dockctl.scenarios.loader import load
from dockctl.sim.conditions.current import Current
from dockctl.sim.conditions.lidar_noise import LidarNoise
from dockctl.sim.conditions.wind import Wind
from tests.commands.conftest import Outcome, dockctl


@pytest.fixture(scope="module")
def once(trained: tuple[Path, Outcome], tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = shutil.copytree(trained[0], tmp_path_factory.mktemp("measured") / "run")
    assert dockctl("evaluate", run, "--episodes", 3).code == 0
    assert dockctl("envelope", run, "--factors", "wind, delay", "--episodes", 3).code == 0
    return run


@pytest.fixture
def measured(once: Path, tmp_path: Path) -> Path:
    """A copy of the run folder that was measured, to write into."""
    return shutil.copytree(once, tmp_path / "run")


def test_counts(measured: Path) -> None:
    table = pd.read_csv(measured / "envelope.csv")
    assert list(table) == list(ENVELOPE)
    assert table.groupby("factor")["value"].apply(list).to_dict() == {
        name: list(FACTORS[name].values) for name in ("delay", "wind")
    }
    assert (table[["docked", "collision", "timeout"]].sum(axis=1) == 3).all()
    assert {"envelope.png", "envelope.svg"} <= {path.name for path in (measured / "figures").iterdir()}


def test_without_wind_or_delay_it_is_the_evaluation(measured: Path) -> None:
    table = pd.read_csv(measured / "envelope.csv")
    episodes = pd.read_csv(measured / "evaluation.csv")
    outcomes = episodes.loc[episodes["start_kind"] == "random", "outcome"].value_counts()
    for row in table[table["value"] == 0].itertuples():
        assert {name: getattr(row, name) for name in outcomes.index} == outcomes.to_dict()


@pytest.mark.thorough
def test_every_value_is_a_scenario(run: Path) -> None:
    policy = load_policy(run)
    own = policy.scenario().scenario
    for name, factor in FACTORS.items():
        for value in factor.values:
            scenario = policy.scenario(None, factor.settings(own, value)).scenario
            assert (name in ("distance", "heading")) is not bool(scenario.conditions)


def test_a_condition_of_another_name_is_the_one_that_is_varied() -> None:
    """Without the name of their condition, a second wind and a second sensor noise would be added."""
    breeze, rain = "{kind: wind, speed_mps: 3, direction_deg: 0, gust_mps: 1}", "{kind: lidar_noise}"
    given = (f"conditions={{breeze: {breeze}, rain: {rain}}}",)
    own = load("s1", overrides=given).scenario
    changed = [
        load("s1", overrides=[*given, *FACTORS[name].settings(own, 2)]).scenario.conditions
        for name in ("wind", "noise")
    ]
    assert [set(conditions) for conditions in changed] == [
        {"breeze", "rain"},
        {"breeze", "rain", "navigation"},
    ]
    wind, noise = changed[0]["breeze"], changed[1]["rain"]
    assert isinstance(wind, Wind) and isinstance(noise, LidarNoise)
    assert (wind.speed_mps, wind.gust_mps, noise.sigma_m) == ((2,), (1,), (0.06,))


def test_one_condition_of_each_kind_is_varied_and_the_others_are_removed() -> None:
    flow = "speed_mps: 0.05, direction_deg: 0"
    given = (
        f"conditions.tide={{kind: current, {flow}, variation_mps: 0.01}}",
        f"conditions.swell={{kind: current, {flow}}}",
        f"conditions.wind={{kind: current, {flow}}}",
    )
    own = load("s1", overrides=given).scenario
    current, wind = (
        load("s1", overrides=[*given, *FACTORS[name].settings(own, 0.2)]).scenario.conditions
        for name in ("current", "wind")
    )
    assert list(current) == ["tide"]
    assert isinstance(current["tide"], Current)
    assert (current["tide"].speed_mps, current["tide"].variation_mps) == ((0.2,), (0.01,))
    assert sorted(wind) == ["swell", "tide", "varied_wind", "wind"]
    assert [wind[name].kind for name in sorted(wind)] == ["current", "current", "wind", "current"]


def test_the_card_has_the_figure(measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dockctl.experiments.export.training_episodes", lambda policy, loaded: [Docked()])
    for _ in range(2):  # the second time it replaces the first
        export_checkpoint([measured], "mine", tmp_path)
    image, card = tmp_path / "mine" / "envelope.png", (tmp_path / "mine" / "card.md").read_text()
    assert image.read_bytes() == (measured / "figures" / "envelope.png").read_bytes()
    assert f"`{hashlib.sha256(image.read_bytes()).hexdigest()}`" in card
    assert "(envelope.png)" in card


class Docked:
    docked, outcome, phase, collided_with = True, "docked", 1, ""
    start = type("Start", (), {"eta": (20.0, 2.0, 2.8)})

    @staticmethod
    def row() -> dict[str, object]:
        return {"outcome": "docked", "phase": 1, "clearance_m": 1.5}


def test_another_policy_s_figure_is_not_in_the_card(
    measured: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dockctl.experiments.export.training_episodes", lambda policy, loaded: [Docked()])
    facts = json.loads((measured / "envelope.json").read_text())
    facts["policy"]["sha256"] = "0" * 64
    (measured / "envelope.json").write_text(json.dumps(facts))
    export_checkpoint([measured], "mine", tmp_path)
    assert not (tmp_path / "mine" / "envelope.png").exists()


def test_an_unknown_factor(run: Path) -> None:
    outcome = dockctl("envelope", run, "--factors", "wnd")
    assert outcome.code == 2
    assert "'wind'" in outcome.err and not (run / "envelope.csv").exists()
