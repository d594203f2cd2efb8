"""``dockctl report``."""

from __future__ import annotations

from pathlib import Path

import pytest

from dockctl.experiments.report import UNFINISHED
from tests.commands.conftest import dockctl


@pytest.mark.slow
@pytest.mark.thorough
def test_the_report_of_a_run_has_its_replay(run: Path, tmp_path: Path) -> None:
    outcome = dockctl("report", run, "--out", tmp_path / "page.html")
    assert outcome.code == 0, outcome.err
    assert outcome.out.split() == [str(tmp_path / "page.html")]
    assert 'id="replay-page"' in (tmp_path / "page.html").read_text(encoding="utf-8")
    for name in ("policy.json", "policy.safetensors"):
        (run / "checkpoints" / "best" / name).write_bytes(b"damaged")
    outcome = dockctl("report", run, "--out", tmp_path / "page.html")
    assert outcome.code == 0, outcome.err
    assert 'id="replay-page"' not in (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "policy.json" in outcome.err


@pytest.mark.slow
@pytest.mark.thorough
def test_without_a_run_the_report_is_of_a_shipped_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = dockctl("report")
    assert outcome.code == 0, outcome.err
    page = Path(outcome.out.strip()).read_text(encoding="utf-8")
    assert 'id="replay-page"' in page
    for section in ("Trajectories", "Evaluation", "Provenance"):
        assert f"<h2>{section}</h2>" in page
    assert UNFINISHED not in page


def test_a_page_with_another_suffix_is_refused(tmp_path: Path) -> None:
    outcome = dockctl("report", tmp_path, "--out", tmp_path / "page.txt")
    assert outcome.code == 2
    assert "page.txt" in outcome.err
