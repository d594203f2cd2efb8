"""``dockctl map``: blocked starts, files, errors."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from dockctl.runs.directory import SHIPPED
from dockctl.runs.tables import MAP
from dockctl.scenarios.loader import load
from dockctl.sim.collision import CollisionChecker
from dockctl.sim.harbor.build import build_harbor
from tests.commands.conftest import SAVEFIG, dockctl


@pytest.mark.slow
def test_blocked_starts_have_no_episode(run: Path) -> None:
    outcome = dockctl("map", "--ckpt", run, "--reach-m", 20, "--step-m", 10, "--headings", "0,90")
    assert outcome.code == 0
    table = pd.read_csv(run / "map.csv")
    assert list(table) == list(MAP)
    assert len(table) == 2 * 25
    assert np.allclose(table["x_m"], 20 + table["dx_m"]) and np.allclose(table["y_m"], 2 + table["dy_m"])
    assert np.allclose(table["heading_deg"], 160 + table["dheading_deg"])
    blocked = table["blocked"] == 1
    assert blocked[(table["x_m"] < 4.5) | (table["x_m"] > 38.5)].all()  # on the quays
    scenario = load("s1").scenario
    checker = CollisionChecker(build_harbor(scenario.harbor, Path()), scenario.vessel.hull)
    eta = np.column_stack([table["x_m"], table["y_m"], np.radians(table["heading_deg"])])
    assert not checker.blocked(eta[~blocked]).any()
    assert table.loc[blocked, "outcome":].isna().all(axis=None)
    assert table.loc[~blocked, "outcome"].isin(["docked", "collision", "timeout"]).all()
    assert re.search(rf"\b{(~blocked).sum()} .*±20 m.* {blocked.sum()}\b", outcome.out)
    assert {"map.png", "map.svg"} <= {path.name for path in (run / "figures").iterdir()}


@pytest.mark.thorough
@pytest.mark.slow
def test_the_same_map_has_the_same_bytes(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Figure, "savefig", SAVEFIG)
    arguments = ("map", "--ckpt", run, "--reach-m", 3, "--step-m", 3, "--headings", "0,180")
    assert dockctl(*arguments, "--csv", tmp_path / "again.csv").code == 0
    first = (run / "figures" / "map.svg").read_bytes()
    assert (tmp_path / "again.csv").read_bytes() == (run / "map.csv").read_bytes()
    assert dockctl(*arguments, "--out", tmp_path / "maps").code == 0
    assert (tmp_path / "maps" / "map-s1-run.csv").read_bytes() == (run / "map.csv").read_bytes()
    assert (tmp_path / "maps" / "map-s1-run.svg").read_bytes() == first


@pytest.mark.thorough
def test_the_table_has_what_the_conditions_drew(run: Path) -> None:
    wind = ("--set", "conditions.wind={speed_mps: [0, 1], direction_deg: 30}")
    arguments = ("--reach-m", 20, "--step-m", 20, "--headings", "0", *wind, "--csv", run / "mine.csv")
    assert dockctl("map", "--ckpt", run, *arguments).code == 0
    table = pd.read_csv(run / "mine.csv")
    assert table["blocked"][0] == 1
    assert table["wind_speed_mps"].isna().equals(table["blocked"] == 1)


def test_changed_values_are_named(run: Path, tmp_path: Path) -> None:
    change = "evaluation.max_steps=5"
    small = ("--set", change, "--reach-m", 0, "--headings", "0", "--json", tmp_path / "map.json")
    outcome = dockctl("map", "--ckpt", run, *small)
    assert json.loads((tmp_path / "map.json").read_text())["set"] == [change]
    assert change in outcome.out.partition(":")[0]


@pytest.mark.thorough
def test_a_map_of_another_scenario_has_its_name(run: Path) -> None:
    small = ("--reach-m", 0, "--headings", "0")
    assert dockctl("map", "--ckpt", run, "--scenario", "s2", *small).code == 0
    assert (run / "map-s2.csv").is_file() and not (run / "map.csv").exists()


def test_paths_below_the_working_directory_are_printed_relative_to_it(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("map", "run", "--reach-m", 0, "--headings", "0")
    files = ["run/figures/map.png", "run/figures/map.svg", "run/map.csv", "run/map.json"]
    assert outcome.out.splitlines()[-4:] == files


def test_the_map_of_a_checkpoint_without_a_run_is_below_figures(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(run / "checkpoints" / "last", tmp_path / "alone")
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("map", "--ckpt", "alone", "--scenario", "s1", "--reach-m", 0, "--headings", "0")
    assert outcome.code == 0
    files = {path.name for path in Path("figures/map").iterdir()}
    assert files == {f"map-s1-alone.{end}" for end in ("csv", "json", "png", "svg")}


@pytest.mark.thorough
def test_a_second_policy_does_not_replace_the_map_of_the_first(run: Path, tmp_path: Path) -> None:
    """Two runs with folders of one name, and one output folder."""
    others = shutil.copytree(run, tmp_path / "others" / run.name)
    shutil.copytree(SHIPPED / "s1", others / "checkpoints" / "best", dirs_exist_ok=True)
    out = ("--reach-m", 0, "--headings", "0", "--out", tmp_path / "maps")
    assert dockctl("map", "--ckpt", run, *out).code == dockctl("map", "--ckpt", run, *out).code == 0
    outcome = dockctl("map", "--ckpt", others, *out)
    assert (outcome.code, outcome.error_code) == (2, "mismatch")


@pytest.mark.thorough
def test_a_changed_scenario_of_the_same_name_has_files_of_its_own(run: Path, tmp_path: Path) -> None:
    (tmp_path / "s1.yaml").write_text("extends: s1\ntask: {max_steps: 5}\n")
    small = ("--reach-m", 0, "--headings", "0")
    for source, name in ((run / "scenario.yaml", "map.csv"), (tmp_path / "s1.yaml", "map-s1.csv")):
        assert not (run / name).exists()
        assert dockctl("map", "--ckpt", run, "--scenario", source, *small).code == 0
        assert (run / name).is_file()


def test_a_map_needs_a_free_start(run: Path, tmp_path: Path) -> None:
    """The boat fits along the quay but not across."""
    quay = "extends: s1\ntask: {initial: [{x_m: 37, y_m: 0, heading_deg: 90}]}\n"
    (tmp_path / "quay.yaml").write_text(quay)
    small = ("--reach-m", 0, "--headings", "90")
    outcome = dockctl("map", "--ckpt", run, "--scenario", tmp_path / "quay.yaml", *small)
    assert outcome.code == 2
    assert outcome.error is not None and "'quay'" in str(outcome.error)
    assert not list(run.glob("map*"))


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("--headings", "0,north"), "wrong_type"),
        (("--headings", "0,360"), "out_of_range"),
        (("--headings", "nan"), "out_of_range"),
        (("--step-m", 0.01), "out_of_range"),
        (("--reach-m", "nan"), ""),  # reported by the option parser
        (("--step-m", "nan"), ""),
        (("--csv", "no/such/folder.csv"), "not_writable"),
        (("--csv", "scenario.yaml"), "invalid"),
        (("--scenario", "nothing"), "unknown_name"),
    ],
)
def test_errors(run: Path, arguments: tuple[object, ...], code: str) -> None:
    outcome = dockctl("map", "--ckpt", run, *arguments)
    assert outcome.code == 2
    assert outcome.error_code == code
    assert not (run / "map.csv").exists()
