"""``dockctl view``."""

from __future__ import annotations

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
    assert "--also and --scenario" in outcome.err
    assert not page.exists()
