"""``dockctl view``."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.commands.conftest import dockctl


@pytest.mark.parametrize("option", ["--also", "--scenario"])
def test_options_of_a_policy_do_not_fit_a_scenario_file(tmp_path: Path, option: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text("extends: s1\n")
    page = tmp_path / "page.html"
    outcome = dockctl("view", file, option, "s2", "--out", page)
    assert outcome.code == 2, outcome.out
    assert option in outcome.err
    assert not page.exists()


def test_the_option_names_the_policy_and_the_scenario_can_be_changed(tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    outcome = dockctl("view", "--ckpt", "s1", "--set", "task.max_steps=2", "--out", page)
    assert outcome.code == 0, outcome.err
    header = re.search(r'id="replay">(.*?)</script>', page.read_text(), re.DOTALL)
    assert header
    assert {episode["outcome"] for episode in json.loads(header[1])["episodes"]} == {"timeout"}


@pytest.mark.slow
def test_a_scenario_without_a_policy_is_shown_by_its_name(tmp_path: Path) -> None:
    pages = [tmp_path / f"{number}.html" for number in range(2)]
    file = Path(__file__).parents[2] / "scenarios" / "s3-opposite.yaml"
    for source, page in zip(("s3-opposite", file), pages, strict=True):
        assert dockctl("view", source, "--out", page).code == 0
    assert pages[0].read_bytes() == pages[1].read_bytes()


def test_a_policy_is_given_once(tmp_path: Path) -> None:
    outcome = dockctl("view", "s1", "--ckpt", "s2", "--out", tmp_path / "page.html")
    assert outcome.code == 2
    assert "s1" in outcome.err and "s2" in outcome.err


def test_without_a_run_a_shipped_policy_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("view", "--scenario", "s1", "--pose", "0,0,0")  # blocked: no episode runs
    assert outcome.code == 2
    assert "s1" in outcome.err
    assert not list(tmp_path.iterdir())
