"""What a report is made of: a run, a study, a comparison, or a training that is still running."""

from __future__ import annotations

import json
import re
import shutil
from contextlib import ExitStack
from pathlib import Path

import pandas as pd
import pytest

from dockctl.agents.progress import REASONS
from dockctl.errors import DockctlError
from dockctl.experiments import report
from dockctl.runs.files import exclusive_lock
from tests.reports.synthetic import episodes, write_run


def title(page: Path) -> str:
    found = re.search(r"<h1>(.*?)</h1>", page.read_text(encoding="utf-8"))
    assert found
    return found[1]


def quiet(text: str) -> None:
    pass


def test_the_study_has_its_own_title_and_experiments(tmp_path: Path) -> None:
    results = tmp_path / "results" / "mine"
    for name in ("small", "large"):
        write_run(results / name / "seed0", count=20)
    page = report.write_report(results, tmp_path / "page.html", note=quiet)
    assert title(page) == "Study mine"
    study = {
        "name": "mine",
        "title": "Does a larger batch help?",
        "experiments": [
            {"name": name, "group": "batch", "title": f"a {name} batch", "scenario": "s1"}
            for name in ("large", "small", "of a part that has not run")
        ],
    }
    study["experiments"][1] |= {"title": "", "set": ["training.batch_size=64"]}  # type: ignore[index]  # JSON
    study["experiments"][2]["name"] = "later"  # type: ignore[index]  # JSON
    (results / "study.json").write_text(json.dumps(study))
    page = report.write_report(results, tmp_path / "page.html", note=quiet)
    assert title(page) == "Does a larger batch help?"
    headings = re.findall(r"<h2>(.*?)</h2>", page.read_text(encoding="utf-8"))
    assert headings == ["large: a large batch", "small: training.batch_size=64"]


def test_a_damaged_study_is_one_error_with_its_field(tmp_path: Path) -> None:
    results = tmp_path / "mine"
    write_run(results / "small" / "seed0", count=20)
    (results / "study.json").write_text('{"name": "mine", "title": 3, "experiments": []}')
    with pytest.raises(DockctlError) as error:
        report.write_report(results, tmp_path / "page.html", note=quiet)
    assert str(error.value).startswith(f"{results / 'study.json'}: title: found 3, expected")
    assert "\n" not in str(error.value)


def test_a_folder_that_has_no_name_of_an_experiment_is_an_error(tmp_path: Path) -> None:
    results = tmp_path / "mine"
    write_run(results / "s3 (old)" / "seed0", count=20)
    with pytest.raises(DockctlError, match="not the name of an experiment") as error:
        report.write_report(results, tmp_path / "page.html", note=quiet)
    assert str(results / "s3 (old)") in str(error.value)


def test_other_paths_are_errors(tmp_path: Path) -> None:
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "evaluation.json").write_text('{"scenario": "s1", "held-out berths": {}}')
    for source in (tmp_path / "nothing", tmp_path, tmp_path / "list.json", tmp_path / "evaluation.json"):
        with pytest.raises(DockctlError) as error:
            report.write_report(source, tmp_path / "page.html", note=quiet)
        assert str(source) in str(error.value)
        assert error.value.code == "not_found"
    (tmp_path / "c.json").write_text('{"policies": {}}')
    with pytest.raises(DockctlError) as error:
        report.write_report(tmp_path / "c.json", tmp_path / "page.html", note=quiet)
    assert "c.json" in str(error.value)
    assert not (tmp_path / "page.html").exists()


def test_the_page_follows_a_training_until_it_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run, page = write_run(tmp_path / "run", count=40), tmp_path / "page.html"
    (run / "trajectories.csv").unlink()
    rows = (run / "episodes.csv").read_bytes()
    (run / "episodes.csv").unlink()  # nothing to show yet
    (run / "provenance.json").write_text(json.dumps({"finished": None, "stop_reason": None}))
    seen: list[tuple[int, int | None] | None] = []
    with ExitStack() as training:
        training.enter_context(exclusive_lock(run))

        def while_it_waits(seconds: float) -> None:
            seen.append(shown(page) if page.exists() else None)
            if len(seen) == 1:
                (run / "episodes.csv").write_bytes(rows)
            elif len(seen) == 2:
                episodes(60).to_csv(run / "episodes.csv", index=False)
            else:  # killed, without a word in the provenance
                training.close()

        monkeypatch.setattr(report.time, "sleep", while_it_waits)
        monkeypatch.setattr(report, "REST", 0)
        assert report.follow(run, page, note=quiet) == page
    assert seen == [None, (40, report.RELOAD_S), (60, report.RELOAD_S)]
    assert shown(page) == (60, None)
    assert [path.name for path in tmp_path.iterdir() if path.suffix != ".html"] == ["run"]


def test_the_last_page_does_not_wait_for_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = write_run(tmp_path / "run", count=40)
    (run / "provenance.json").write_text(json.dumps({"finished": None, "stop_reason": None}))
    pauses: list[float] = []
    with ExitStack() as training:
        training.enter_context(exclusive_lock(run))

        def while_it_waits(seconds: float) -> None:
            pauses.append(seconds)
            training.close()

        monkeypatch.setattr(report.time, "sleep", while_it_waits)
        monkeypatch.setattr(report, "REST", 1e6)
        report.follow(run, tmp_path / "page.html", note=quiet)
    assert pauses == [report.POLL_S]


def shown(page: Path) -> tuple[int, int | None]:
    """Return the number of episodes in the page, and after how many seconds it loads itself again."""
    found = re.search(r'id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    data = json.loads(found[1])
    (returns,) = (chart for chart in data["charts"].values() if chart["title"] == "Return")
    dots = [line for line in returns["series"] if line["kind"] == "dots"]
    return sum(len(line["x"]) for line in dots), data["reload_s"]


def test_a_training_that_has_ended_is_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = write_run(tmp_path / "run", count=20)
    (run / "provenance.json").write_text(json.dumps({"finished": "2026-01-01", "stop_reason": "steps"}))
    monkeypatch.chdir(tmp_path)
    page = report.follow(run, None, note=quiet)
    assert page == Path("report-run.html")
    assert shown(page)[1] is None
    assert REASONS["steps"] in page.read_text(encoding="utf-8")


def test_a_damaged_table_is_an_error(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", count=20)
    table = pd.read_csv(run / "episodes.csv").drop(columns="return")
    table.to_csv(run / "episodes.csv", index=False)
    with pytest.raises(DockctlError) as error:
        report.write_report(run, tmp_path / "page.html", note=quiet)
    assert "episodes.csv" in str(error.value)
    shutil.rmtree(run)
