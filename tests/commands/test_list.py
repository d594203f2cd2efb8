"""`dockctl list`: everything that is registered with its origin; tab-separated when piped, else a table."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Literal

import pytest
from rich.text import Text
from typer.testing import CliRunner

from dockctl.cli import app
from dockctl.commands import list as command
from dockctl.errors import DockctlError
from dockctl.experiments.registered import rows_of
from dockctl.plugins import CONDITIONS, REWARD_TERMS, VESSELS
from dockctl.runs.directory import SHIPPED
from dockctl.scenarios.extensions import Condition, Disturbance, register

GENTLE = Path(__file__).parent.parent.parent / "examples/local-term/gentle.py"
runner = CliRunner()


def rows(*arguments: object) -> dict[str, list[str]]:
    """Kind, source, parameters and origin by name."""
    return {line["name"]: [line[key] for key in KEYS] for line in lines(*arguments)}


KEYS = ("kind", "source", "parameters", "origin")


def lines(*arguments: object) -> list[dict[str, str]]:
    result = runner.invoke(app, ["list", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    head, *lines = [line.split("\t") for line in result.stdout.splitlines()]
    assert {"listing", "name", "description", *KEYS} == {*head}
    return [dict(zip(head, line, strict=True)) for line in lines]


def test_rewards() -> None:
    found = rows("rewards")
    assert {"collision", "intermediate", "final", "distance", "orientation", "speed", "progress"} <= set(
        found
    )
    assert found["speed"] == [
        "dense",
        "eqs. 3.10, 3.13",
        "distance_unit_m=1.0, floor_m=0.4, floor=None",
        "dockctl",
    ]


def test_observations() -> None:
    assert rows("observations")["phase"] == ["observation", "eq. 3.12", "", "dockctl"]


def test_action_types() -> None:
    """In a new process, where no action type has been used."""
    listed = subprocess.run(
        [sys.executable, "-m", "dockctl", "list", "actions"], capture_output=True, text=True
    )
    head, *found = [line.split("\t") for line in listed.stdout.splitlines()]
    parameters = {line[head.index("name")]: line[head.index("parameters")] for line in found}
    assert set(parameters) >= {"grid", "continuous"}
    assert parameters["grid"].startswith("propeller_n=")


def test_scenarios() -> None:
    found = rows("scenarios")
    assert list(found) == sorted(found)
    assert {"s1", "s2", "s3", "marina"} <= set(found)
    assert found["s3"][0] == "two phases"


def test_everything_is_listed_by_default_with_a_description(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(SHIPPED / "s1", tmp_path / "checkpoints" / "mine")
    found = lines()
    assert [line for name in command.LISTINGS for line in lines(name)] == found
    assert {line["listing"] for line in found} >= {*command.LISTINGS} - {"policies", "conditions"}
    assert all(line["description"] for line in found)
    result = runner.invoke(app, ["list", "--json", "-"])
    assert json.loads(result.stdout) == found
    assert any(line["name"] == "mine" and line["origin"].endswith("mine") for line in found)


@pytest.mark.parametrize("content", ["{", "{}", '{"seed": 1, "env_steps": null}'])
def test_a_damaged_checkpoint_is_listed_as_broken(
    content: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "checkpoints" / "mine").mkdir(parents=True)
    (tmp_path / "checkpoints" / "mine" / "policy.json").write_text(content)
    assert rows("checkpoints")["mine"][0] == "broken"


def test_vessels_and_harbors() -> None:
    assert lines("vessels")[0]["description"] == "3 x 1 m, 150 kg"
    described = {line["name"]: line["description"] for line in lines("harbors")}
    assert described["reference"] == "34 x 80 m, 2 rows, 28 berths"
    kinds = {name: row[0] for name, row in rows("harbors").items()}
    assert kinds == dict.fromkeys(("haven", "l-basin", "reference", "stern-to", "t-head"), "marina")


def test_a_local_file_is_listed_with_its_path() -> None:
    found = rows("rewards", "--plugin", GENTLE)
    assert found["gentle_turns"] == ["dense", "examples/local-term", "limit_radps=0.03", f"file {GENTLE}"]


def test_a_broken_one_is_listed_as_broken(tmp_path: Path) -> None:
    def fail() -> None:
        raise DockctlError("no luck")

    REWARD_TERMS.register_lazily("unlucky", "package p 1", fail)
    VESSELS.register("sunk", tmp_path / "sunk.yaml")
    assert rows("rewards")["unlucky"] == ["broken", "", "", "package p 1"]
    assert any(line["description"] == "no luck" for line in lines("rewards"))
    assert rows("vessels")["sunk"][0] == "broken"


def test_a_plugin_file_that_fails_is_the_only_output(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("1 / 0\n")
    for name, reason in (("bad.py", "ZeroDivisionError"), ("none.py", "none.py")):
        result = runner.invoke(app, ["list", "rewards", "--plugin", str(tmp_path / name)])
        assert result.exit_code == 2
        assert not result.stdout
        assert reason in result.stderr


def test_an_unknown_registry_lists_the_known_ones() -> None:
    result = runner.invoke(app, ["list", "boats"])
    assert result.exit_code == 2
    assert "rewards" in result.stderr


def test_a_table_in_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(command.sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "160")
    speed = ("speed", "dense", "floor [m]", "floor=0.02", "eq. 3.10", "dockctl")
    command._print({"rewards": [speed, ("x", "broken", "", "", "", "")]})
    out = capsys.readouterr().out
    assert "─" in out
    assert "floor [m]" in out


def test_a_class_without_a_docstring_is_not_described_by_that_of_its_base() -> None:
    @register(CONDITIONS, group="water")
    class Silent(Condition):
        kind: Literal["silent"] = "silent"

        def build(self, num_boats: int) -> Disturbance:
            return Disturbance()

    (row,) = (row for row in rows_of("conditions") if row[0] == "silent")
    assert row[2] == ""


@pytest.mark.parametrize("listing", ["vessels", "harbors", "conditions"])
def test_a_table_fits_into_40_columns(
    listing: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command.sys.stdout, "isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "40")
    command._print({listing: list(rows_of(listing))})
    printed = Text.from_ansi(capsys.readouterr().out).plain.splitlines()
    assert len(printed) > 3
    assert max(map(len, printed)) <= 40
