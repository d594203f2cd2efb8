"""The results pages: equal to those in docs; their numbers against the archived tables, read with csv."""

from __future__ import annotations

import csv
import gzip
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from dockctl.errors import DockctlError
from dockctl.experiments.study import load_study, make_jobs
from dockctl.reports.style import figure_style
from dockctl.run_files import SCENARIO
from dockctl.scenarios.content import first_difference
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Scenario
from studies.thesis import build
from studies.thesis.claims import MEASURES
from studies.thesis.data import Archive, load_facts
from studies.thesis.measures import OF_MANEUVERS, OF_TRAININGS
from studies.thesis.page import Page

pytestmark = [pytest.mark.slow, pytest.mark.thorough]  # they read all archived runs

STUDY = load_study("thesis")
Pages = dict[str, tuple[Page, str]]
Rows = list[dict[str, str]]


@pytest.fixture(scope="module")
def pages() -> Pages:
    return {page.path: (page, text) for page, text in build.rendered()}


def read(name: str) -> Rows:
    """An archived table, by path below the archive."""
    content = (build.RESULTS / name).read_bytes()
    text = (gzip.decompress(content) if name.endswith(".gz") else content).decode()
    return list(csv.DictReader(text.splitlines()))


def table(text: str, *columns: str) -> Rows:
    """The rows of the first Markdown table with these columns."""
    for block in re.findall(r"(?:^\|.*\n)+", text, flags=re.MULTILINE):
        head, _, *lines = [[cell.strip() for cell in line[1:-1].split("|")] for line in block.splitlines()]
        if {*columns} <= {*head}:
            return [dict(zip(head, line, strict=True)) for line in lines]
    raise AssertionError(f"no table with {columns}")


def outcomes(rows: Rows) -> str:
    counts = Counter(row["outcome"] for row in rows)
    return " / ".join(f"{counts[outcome]:,}" for outcome in ("docked", "collision", "timeout"))


def test_pages_in_docs_are_those_of_the_archived_results(pages: Pages) -> None:
    for path, (_, text) in pages.items():
        assert (build.DOCS / path).read_text(encoding="utf-8") == text, path
    shown = {name for page, _ in pages.values() for name in page.figures}
    assert {path.stem for path in (build.DOCS / build.FIGURES).glob("*.png")} == shown
    assert {f"results/{path.name}" for path in (build.DOCS / "results").iterdir()} | {"results.md"} == {
        *pages
    }


def without_floor(scenario: Scenario) -> list[dict[str, Any]]:
    terms = [term.model_dump() for term in scenario.reward.terms]
    for term in terms:
        term["params"] = {key: value for key, value in term["params"].items() if not key.startswith("floor")}
    return terms


def test_archived_runs_are_of_the_current_scenarios() -> None:
    """Except for what was new later: the floor of the speed term, averaged copies and held actions."""
    archive = Archive(STUDY, build.RESULTS)
    jobs = {(job.experiment.name, job.seed): job for job in make_jobs(STUDY.experiments, build.RESULTS)}
    runs = [(e.name, run) for e in STUDY.experiments for run in archive[e.name]]
    assert {(name, run.seed) for name, run in runs} == {*jobs}
    for name, run in runs:
        current = jobs[name, run.seed].scenario
        earlier = ["training.averaged_copies=null", "training.action_repeat=1"]
        archived = load(run.folder / SCENARIO, received=True, overrides=earlier).scenario
        assert first_difference(current, archived, ignore=("reward",)) is None, run.folder
        assert without_floor(current) == without_floor(archived), run.folder


def test_every_figure_is_shown(pages: Pages) -> None:
    for page, text in pages.values():
        assert {Path(name).stem for name in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text)} == set(page.figures)


def test_every_figure_of_the_thesis_is_in_the_index(pages: Pages) -> None:
    rows = table(pages["results.md"][1], "thesis", "ours")
    cited = [re.findall(r"(\w+\.\d+)(?:-\w+\.(\d+))?", row["thesis"]) for row in rows]
    indexed = {
        f"{first.split('.')[0]}.{number}"
        for row in cited
        for first, last in row
        for number in range(int(first.split(".")[1]), int(last or first.split(".")[1]) + 1)
    }
    facts = load_facts()
    shown = {fact.figure for each in (*facts.training.values(), *facts.maneuvers.values()) for fact in each}
    assert {f"4.{number}" for number in range(1, 38)} | {f"B.{number}" for number in range(1, 8)} == shown
    assert shown | {"3.6", "3.9", "3.10", "3.13", "3.14", "3.15", "4.38", "4.39", "4.40"} <= indexed


def test_links_lead_to_pages_and_headings(pages: Pages) -> None:
    for path, (_, text) in pages.items():
        for target, anchor in re.findall(r"(?<!!)\[[^]]*\]\(([^)#]+)#?([^)]*)\)", text):
            file = (build.DOCS / path).parent / target
            assert file.is_file(), (path, target)
            heads = {
                _anchor(line) for line in file.read_text(errors="ignore").splitlines() if line[:1] == "#"
            }
            assert not anchor or anchor in heads, (path, target, anchor)


def _anchor(head: str) -> str:
    return re.sub(r"[^\w\- ]", "", head.lstrip("# ").lower()).replace(" ", "-")


def test_every_page_names_the_commits_of_its_runs(pages: Pages) -> None:
    commits = {
        json.loads(file.read_text())["git_commit"][:7] for file in build.RESULTS.glob("*/*/provenance.json")
    }
    for path, (page, text) in pages.items():
        named = {commit for commit in commits if f"`{commit}`" in text}
        assert page.used
        assert named == {run.commit for runs in page.used.values() for run in runs}, path
    assert {commit for commit in commits if f"`{commit}`" in pages["results.md"][1]} == commits


def test_selection_and_test_episodes_are_apart(pages: Pages) -> None:
    rows = {row["experiment"]: row for row in table(pages["results.md"][1], "experiment", "test starts")}
    for name, seeds, test in (("s2", 5, "random"), ("marina", 3, "held_out")):
        episodes = [row for seed in range(seeds) for row in read(f"{name}/seed{seed}/evaluation.csv")]
        tests = [row for row in episodes if row["start_kind"] == test]
        selection = [row for row in episodes if row["start_kind"] != test]
        docked = sum(row["outcome"] == "docked" for row in selection)
        assert rows[f"`{name}`"]["test starts"] == outcomes(tests)
        assert rows[f"`{name}`"]["selection episodes docked"] == f"{docked} of {len(selection)}"


def test_outcomes_near_every_training_start_of_scenario_2(pages: Pages) -> None:
    rows = table(pages["results/scenario-2.md"][1], "seed", "(20, −2, 200°)")
    for seed in range(5):
        tests = [row for row in read(f"s2/seed{seed}/evaluation.csv") if row["start_kind"] == "random"]
        near = [row for row in tests if abs(float(row["y_m"]) + 2) <= 1]
        assert rows[seed]["(20, −2, 200°)"] == outcomes(near)
    assert len(rows) == 6


def test_early_collisions_of_the_thesis_learner(pages: Pages) -> None:
    rows = table(pages["results/reward.md"][1], "scenario", "δd in", "docked", "collision", "timeout")
    for row in rows:
        suffix = "-meters" if row["δd in"] == "meters" else ""
        episodes = read(f"thesis-s{row['scenario']}{suffix}/seed0/episodes.csv.gz")
        window = [episode for episode in episodes if 200 <= int(episode["episode"]) <= 2000]
        share = sum(episode["outcome"] == "collision" for episode in window) / len(window)
        assert row["collision"] == f"{100 * share:.0f} %"
    assert len(rows) == 6


def test_collisions_against_waiting(pages: Pages) -> None:
    rows = table(pages["results/reward.md"][1], "best collision", "waiting at the start")
    for row in rows:
        unit = "1" if row["δd in"] == "meters" else "20"
        returns = [r for r in read(f"s{row['scenario']}/seed0/returns.csv") if r["distance_unit_m"] == unit]
        best = max(float(r["return"]) for r in returns if r["outcome"] == "collision")
        (waiting,) = (float(r["return"]) for r in returns if r["behavior"] == "loiter at the start")
        assert (row["best collision"], row["waiting at the start"]) == (f"{best:,.0f}", f"{waiting:,.0f}")
        assert row["collision costs more than waiting"] == ("yes" if best < waiting else "no")
    assert len(rows) == 4


def test_every_claim_has_a_verdict(pages: Pages) -> None:
    rows = table(pages["results.md"][1], "thesis", "where", "verdict")
    verdicts = {row["thesis"]: row["verdict"].strip("*") for row in rows}
    assert set(verdicts.values()) <= {"reproduced", "partly", "not reproduced", "better"}
    assert [*verdicts] == [claim.claim for claim in load_facts().claims]
    assert verdicts["docks at the berth on the other side"] == "not reproduced"  # 0 of 5 seeds
    assert verdicts["docks from the five poses of Table 4.3"] == "partly"  # selection poses, no test
    assert verdicts["a forward pass takes 2 ms"] == "better"


def test_facts_name_existing_measures() -> None:
    facts = load_facts()
    assert {claim.measure for claim in facts.claims} == {*MEASURES}
    assert {fact.measure for each in facts.training.values() for fact in each} == {*OF_TRAININGS}
    assert {fact.measure for each in facts.maneuvers.values() for fact in each} == {*OF_MANEUVERS}


def test_missing_runs_are_reported(tmp_path: Path) -> None:
    with pytest.raises(DockctlError, check=lambda error: error.code == "not_found") as caught:
        next(build.rendered(tmp_path))
    assert str(tmp_path / "s1") in str(caught.value)


def test_the_numbers_of_the_thesis_are_marked_in_the_figures(pages: Pages) -> None:
    with figure_style():
        by_distance = pages["results/generalization.md"][0].figures["s3-map"]().subfigs[-1].axes[0]
        forward = pages["results/time.md"][0].figures["latency"]().axes[2]
    assert [line.get_xdata()[0] for line in by_distance.lines if line.get_linestyle() != "-"] == [3, 5]
    assert {text.get_text() for text in by_distance.texts} == {"§4.4", "§5.2"}
    assert [line.get_xdata()[0] for line in forward.lines] == [500, 2]
    assert {text.get_text() for text in forward.texts} == {"thesis 2 ms"}


def test_figures_repeat_byte_for_byte(pages: Pages) -> None:
    draw = pages["results/scenarios.md"][0].figures["surge"]
    with figure_style():
        assert build.png(draw()) == build.png(draw())


def test_build_writes_pages_and_figures_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = Page("results/a.md", "a.md", {}, {"a": lambda: Figure((2, 2))})
    monkeypatch.setattr(build, "rendered", lambda results: iter([(page, "text\n")]))
    figures = tmp_path / build.FIGURES
    figures.mkdir(parents=True)
    for file in (tmp_path / "model.md", figures.parent / "other.png", figures / "other.png"):
        file.write_text("before")
    build.build(docs=tmp_path)
    files = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*") if path.is_file()}
    own = {"results/a.md", "figures/results/a.png"}
    others = {"model.md", "figures/other.png", "figures/results/other.png"}
    assert files == own | others
    assert {(tmp_path / name).read_text() for name in others} == {"before"}
