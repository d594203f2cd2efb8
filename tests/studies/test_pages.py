"""The pages: the same text from the same kept files, also when most is not run, and what stands in docs."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from dockctl.experiments.archive import archive
from dockctl.experiments.jobs import jobs_of
from dockctl.scenarios.loader import dump, load
from dockctl.scenarios.study import load_study
from studies.thesis.build import FIGURES, pages_of, write_pages
from studies.thesis.kept import read_results
from studies.thesis.page import Page
from tests.reports.synthetic import write_run

ROOT = Path(__file__).parents[2]
STUDY = load_study("thesis")
LIBRARIES = {"numpy": "2.0"}


def finished_run(folder: Path, source: str, seed: int) -> Path:
    """A made-up run with all that the pages read."""
    scenario = load(source, overrides=[f"training.seed={seed}"]).scenario
    write_run(folder, intermediate=scenario.task.intermediate is not None, poses=1, count=300)
    (folder / "scenario.yaml").write_text(dump(scenario))
    facts = {
        "seed": seed, "git_commit": "0123456789", "python": "3.11", "libraries": LIBRARIES,
        "hardware": {"processor": "a processor", "cores": 2}, "stop_reason": "mastered",
        "finished": "2026-01-01T12:00:00+00:00",
    }  # fmt: skip
    (folder / "provenance.json").write_text(json.dumps(facts))
    pd.DataFrame({"env_steps": [100_000], "wall_s": [60.0 + seed]}).to_csv(folder / "timing.csv", index=False)
    rows = {"update": [1, 2], "env_steps": [10, 20], "loss": 0.5, "td_error": [0.3, 0.2], "q_mean": 1.0}
    pd.DataFrame(rows).to_csv(folder / "updates.csv", index=False)
    evaluation = pd.DataFrame(
        {
            "start_kind": ["pose", "random", "random"], "start": [0, 0, 1], "x_m": 20.0, "y_m": 2.0,
            "heading_deg": 160.0, "outcome": ["docked", "docked", "collision"], "phase": 1, "steps": 100,
            "path_length_m": 16.0, "clearance_m": 0.5, "control_changes": 0.3, "time_s": 50.0,
        }
    )  # fmt: skip
    evaluation.to_csv(folder / "evaluation.csv", index=False)
    return folder


def mapped(folder: Path) -> None:
    """Give a run a map, a recording of its failures and one elsewhere."""
    dx, dy = (side.ravel() for side in np.meshgrid([-2.0, 0.0, 2.0], [-2.0, 0.0, 2.0]))
    table = pd.DataFrame(
        {
            "dx_m": dx, "dy_m": dy, "dheading_deg": 0.0, "x_m": 23 + dx, "y_m": -10 + dy, "heading_deg": 90.0,
            "blocked": 0, "outcome": np.where(dx + dy == 0, "docked", "collision"), "phase": 0,
        }
    )  # fmt: skip
    table.to_csv(folder / "map.csv", index=False)
    for name in ("failures", "s3-opposite"):
        write_run(folder / "transfer" / name, intermediate=True)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    runs, results = tmp_path_factory.mktemp("runs"), tmp_path_factory.mktemp("results")
    for source, seeds in (("s1", 3), ("s3", 2)):
        for seed in range(seeds):
            run = finished_run(runs / source / str(seed), source, seed)
            if source == "s3":
                mapped(run)
            archive(run, results, source, seed)
    for name in ("thesis-s1", "ablation-none", "ablation-huber"):
        archive(finished_run(runs / name, "s1", 0), results, name, 0)
    return results


def texts(pages: list[Page]) -> dict[str, str]:
    return {page.path: page.text for page in pages}


def pictures(page: Page) -> set[str]:
    return {Path(name).stem for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", page.text)}


def test_the_same_kept_files_give_the_same_text(results: Path) -> None:
    assert texts(pages_of(STUDY, results)) == texts(pages_of(STUDY, results))


def test_without_any_run_every_page_says_what_would_make_it(tmp_path: Path) -> None:
    pages = pages_of(STUDY, tmp_path)
    assert not any(page.figures for page in pages)
    assert all("dockctl reproduce" in page.text for page in pages)
    assert "not run" in texts(pages)["results.md"]


def test_every_picture_is_drawn_and_every_drawing_shown(results: Path) -> None:
    for page in pages_of(STUDY, results):
        assert pictures(page) == set(page.figures), page.path


def test_every_seed_is_told(results: Path) -> None:
    rows = texts(pages_of(STUDY, results))["results/scenario-1.md"].splitlines()
    assert [row.split("|")[1].strip() for row in rows if row.startswith(("| 0 |", "| 1 |", "| 2 |"))] == [
        "0",
        "1",
        "2",
    ]
    assert any(row.startswith("| interquartile mean |") for row in rows)


def test_every_figure_of_the_thesis_is_told_of(results: Path) -> None:
    index = texts(pages_of(STUDY, results))["results.md"]
    cited = [
        *("3.6", "3.9", "3.10", "3.13-3.15", "4.1-4.3", "4.4-4.10", "4.11-4.13", "4.14-4.20", "4.21-4.23"),
        *("4.24-4.30", "4.31-4.37", "4.38", "4.39, 4.40", "B.1-B.7"),
    ]
    assert all(re.search(rf"Figs?\. {re.escape(numbers)}\b", index) for numbers in cited)


def test_links_between_the_pages_lead_somewhere(results: Path, tmp_path: Path) -> None:
    pages = texts(pages_of(STUDY, results))
    for path, text in pages.items():
        for target, anchor in re.findall(r"(?<!!)\[[^]]*\]\(([^)#]+\.md)#?([^)]*)\)", text):
            found = (Path("/") / Path(path).parent / target).resolve().relative_to("/").as_posix()
            there = pages.get(found) or (ROOT / "docs" / found).read_text()
            heads = {_anchor(line) for line in there.splitlines() if line.startswith("#")}
            assert not anchor or anchor in heads or "ot run" in there, (path, target, anchor)


def test_writing_draws_every_figure_and_takes_away_old_ones(results: Path, tmp_path: Path) -> None:
    pages = [page for page in pages_of(STUDY, results) if page.path in ("results.md", "results/ablation.md")]
    (tmp_path / FIGURES).mkdir(parents=True)
    (tmp_path / FIGURES / "old.png").write_bytes(b"")
    write_pages(pages, tmp_path)
    assert {path.stem for path in (tmp_path / FIGURES).iterdir()} == {"ablation"}
    assert (tmp_path / "results.md").read_text() == pages[0].text


def test_a_training_under_way_has_no_maneuver_yet_and_one_scenario_is_enough(tmp_path: Path) -> None:
    run = finished_run(tmp_path / "run", "s3", 0)
    for name in ("trajectories.csv", "evaluation.csv"):
        (run / name).unlink()
    facts = json.loads((run / "provenance.json").read_text())
    (run / "provenance.json").write_text(json.dumps(facts | {"finished": None, "stop_reason": None}))
    archive(run, tmp_path / "results", "s3", 0)
    pages = pages_of(STUDY, tmp_path / "results")
    (page,) = (page for page in pages if page.path == "results/scenario-3.md")
    assert "0, under way" in page.text
    assert pictures(page) == set(page.figures) == {"s3-training"}
    write_pages(pages, tmp_path / "docs")
    assert (tmp_path / "docs" / FIGURES / "scenarios.png").is_file()


def test_kept_results_are_of_the_scenarios_as_they_stand() -> None:
    jobs = {(job.experiment.name, job.seed): job for job in jobs_of(STUDY.experiments, ROOT)}
    kept = [run for runs in read_results(STUDY, ROOT / "results" / "thesis").values() for run in runs]
    experiments = [run.folder.parent.name for run in kept]
    strangers = {
        f"{experiment}, seed {run.seed}": difference
        for experiment, run in zip(experiments, kept, strict=True)
        if (difference := jobs[experiment, run.seed].difference(run.folder))
    }
    assert kept
    assert not strangers


def test_the_pages_in_docs_are_what_the_kept_results_say() -> None:
    pages = pages_of(STUDY, ROOT / "results" / "thesis")
    for page in pages:
        assert (ROOT / "docs" / page.path).read_text(encoding="utf-8") == page.text, page.path
    shown = {name for page in pages for name in page.figures}
    assert {path.stem for path in (ROOT / "docs" / FIGURES).glob("*.png")} == shown


def _anchor(head: str) -> str:
    return re.sub(r"[^\w\- ]", "", head.lstrip("# ").lower()).replace(" ", "-")
