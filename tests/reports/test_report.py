"""The HTML report: its data are those of the tables, and the page works in a browser."""

from __future__ import annotations

import base64
import gzip
import json
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from dockctl.analysis.episodes import summarize
from dockctl.errors import DockctlError
from dockctl.reports.charts import numbers, thinned
from dockctl.reports.report import Page, run_page
from dockctl.reports.study_report import Trial, comparison_page, study_page
from dockctl.runs.reader import read_run
from tests.reports import synthetic
from tests.reports.browser import opened, wait


def page_of(folder: Path) -> Page:
    return run_page(read_run(folder), "The step limit is reached.")


def data_of(html: str) -> dict[str, Any]:
    found = re.search(r'id="data">(.*?)</script>', html, re.DOTALL)
    assert found
    return dict(json.loads(found[1]))


def chart(page: Page, title: str) -> dict[str, Any]:
    (found,) = (chart for chart in page.charts.values() if chart["title"] == title)
    return found


def run_folder(folder: Path, **options: Any) -> Path:
    """A run with an evaluation, a success map and latencies."""
    synthetic.write_run(folder, **options)
    evaluation = pd.DataFrame(
        {
            "start_kind": ["pose", "random", "random"],
            "start": [0, 0, 1],
            "x_m": 20.0,
            "heading_deg": [160.0, 150.0, -170.0],
            "outcome": ["docked", "docked", "collision"],
            "collided_with": ["", "", "quay <b>"],
            "phase": 1,
            "return": 1000.0,
            "steps": [80, 90, 100],
            "distance_m": 0.5,
            "heading_error_deg": 1.0,
            "speed_mps": 0.05,
            "path_length_m": 16.0,
            "clearance_m": [1.0, 2.0, np.nan],
            "control_changes": 0.25,
        }
    )
    evaluation.to_csv(folder / "evaluation.csv", index=False)
    synthetic.success_map(failing={(4.0, 4.0)}, blocked={(-4.0, -4.0)}).to_csv(
        folder / "map.csv", index=False
    )
    (folder / "figures").mkdir()
    times = np.linspace(0.1, 1.0, 50)
    parts = dict.fromkeys(("scan_ms", "state_ms", "forward_ms", "decision_ms"), times)
    pd.DataFrame(parts).to_csv(folder / "figures" / "latency.csv", index_label="decision")
    scenario = folder / "scenario.yaml"
    scenario.write_text(scenario.read_text() + "vessel: {control_period_s: 0.5}\n")
    (folder / "provenance.json").write_text(json.dumps({"dockctl": "9.8.7", "stop_reason": "steps"}))
    return folder


def test_curves_have_the_values_of_the_tables(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", count=120, intermediate=True)
    page = page_of(folder)
    episodes = pd.read_csv(folder / "episodes.csv")
    dots = chart(page, "Return")["series"][0]
    own = episodes[episodes["start_kind"] == "pose"]
    assert dots["x"] == own["episode"].tolist()
    np.testing.assert_allclose(dots["y"], own["return"], rtol=1e-5)
    shares = np.sum([s["y"] for s in chart(page, "Outcomes")["series"]], axis=0)
    np.testing.assert_allclose(shares, 1.0, atol=1e-5)
    updates = pd.read_csv(folder / "updates.csv")
    for title, column in (
        ("Loss", "loss"),
        ("Mean |TD error|", "td_error"),
        ("Mean Q", "q_mean"),
        ("Gradient norm", "gradient_norm"),
    ):
        np.testing.assert_allclose(chart(page, title)["series"][0]["y"], updates[column], rtol=1e-5)
    track = pd.read_csv(folder / "trajectories.csv")
    force = chart(page, "Propeller force")["series"][0]
    np.testing.assert_allclose(force["y"], track["propeller_n"], rtol=1e-5)
    assert chart(page, "Distance to the goal")["series"][0]["breaks"] == [int((track["phase"] == 0).sum())]


def test_evaluation_map_and_latency(tmp_path: Path) -> None:
    page = page_of(run_folder(tmp_path / "run", count=30))
    rows = chart(page, "Success with 95 % interval")["rows"]
    assert [(row["label"], row["text"]) for row in rows] == [
        ("made-up: evaluation poses", "100.0%"),
        ("made-up: random starts", "50.0%"),
    ]
    (panel,) = chart(page, "Success by start pose")["panels"]
    assert panel["title"] == "heading of the pose: 23 of 24"
    assert pd.Series(panel["cells"]["outcome"]).value_counts().to_dict() == {
        "docked": 23,
        "timeout": 1,
        "blocked": 1,
    }
    assert sum(chart(page, "Forward pass")["series"][0]["y"]) == 50
    assert ("Random starts", "50.0%") in [(name, value) for name, value, _ in page.facts]


def test_the_page_is_one_file_and_escapes_text(tmp_path: Path) -> None:
    html = page_of(run_folder(tmp_path / "run", count=30)).html("<p>a replay</p>")
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#)|@import|\bfetch\(|url\(\s*["']?http""", html)
    assert "quay &lt;b&gt;" in html
    assert ">190<" in html  # the heading of the start that failed
    assert "9.8.7" in html
    packed = re.search(r'id="replay-page">(.*?)</script>', html)
    assert packed
    assert gzip.decompress(base64.b64decode(packed[1])) == b"<p>a replay</p>"
    assert data_of(html)["reload_s"] is None
    assert data_of(page_of(tmp_path / "run").html(reload_s=10))["reload_s"] == 10


def test_what_was_not_measured_is_left_out(tmp_path: Path) -> None:
    folder = synthetic.write_run(tmp_path / "run", count=20)
    html = page_of(folder).html()
    titles = re.findall(r"<h2>(.*?)</h2>", html)
    assert titles == ["Trajectories", "Training", "Network updates"]
    assert 'id="replay"' not in html


def test_measurements_of_an_earlier_policy_are_left_out(tmp_path: Path) -> None:
    folder = run_folder(tmp_path / "run", count=20)
    best = folder / "checkpoints/best"
    best.mkdir(parents=True)
    (best / "policy.json").write_text(json.dumps({"sha256": "current"}))
    measured = ["Evaluation", "Failures", "Success map", "Latency"]
    for policy, titles in (("current", measured), ("earlier", [])):
        for name in ("evaluation", "map", "figures/latency"):
            (folder / f"{name}.json").write_text(json.dumps({"policy": {"sha256": policy}}))
        page = page_of(folder)
        shown = re.findall(r"<h2>(.*?)</h2>", page.html())
        assert shown == ["Trajectories", "Training", "Network updates", *titles, "Provenance"]
        assert ("Random starts" in [name for name, _, _ in page.facts]) == bool(titles)


def test_a_study_pools_its_seeds(tmp_path: Path) -> None:
    runs = [read_run(run_folder(tmp_path / f"seed{i}", count=30)) for i in range(2)]
    page = study_page("Does it help?", tmp_path, [Trial("large", "batch", "a larger batch", runs)])
    assert page.title == "Does it help?"
    (row,) = chart(page, "Random starts")["rows"]
    assert (row["value"], row["dots"]) == (0.5, [0.5, 0.5])
    assert [
        "large",
        "a larger batch",
        "random starts",
        "2",
        "2 of 4",
        "50.0%",
        "15.0% to 85.0%",
    ] in page.sections[0].tables[0].rows
    assert len(chart(page, "Return")["series"]) == 2


def test_a_comparison(tmp_path: Path) -> None:
    episodes = [
        {
            "outcome": "docked" if i < docked else "timeout", "collided_with": "", "phase": 1, "steps": 100,
            "distance_m": 0.5, "heading_error_deg": 1.0, "speed_mps": 0.1, "path_length_m": 16.0,
            "clearance_m": 1.0, "control_changes": 0.2,
        }
        for docked in (3, 6) for i in range(8)
    ]  # fmt: skip
    first, second = summarize(episodes[:8], 0.5), summarize(episodes[8:], 0.5)
    difference = {"first": 0.375, "second": 0.75, "value": 0.375, "low": 0.1, "high": 0.6, "pairs": 8}
    result = {
        "scenario": "s2",
        "random_seed": 5,
        "policies": {"a": {"random": first}, "b": {"random": second}},
        "differences": [
            {
                "starts": "random",
                "first": "a", "second": "b", "only_first_docks": 0, "only_second_docks": 3,
                "mcnemar_p": 0.25, "docked": difference,
            }
        ],
    }  # fmt: skip
    page = comparison_page(result, tmp_path / "c.json")
    assert [row["text"] for row in chart(page, "Random starts")["rows"]] == ["37.5%", "75.0%"]
    (row,) = chart(page, "Difference in success")["rows"]
    assert (row["value"], row["low"], row["high"], row["text"]) == (37.5, 10.0, 60.0, "+37.5 %")
    with pytest.raises(DockctlError) as error:
        comparison_page({"scenario": "s2"}, tmp_path / "c.json")
    assert "c.json" in str(error.value)


def test_long_tables_are_thinned_with_their_last_row() -> None:
    table = pd.DataFrame({"episode": range(1, 1002)})
    kept = thinned(table, 100)["episode"].tolist()
    assert len(kept) <= 100
    assert kept[-1] == 1001
    assert numbers([1.0, 2.34567891, np.nan]) == [1, 2.34568, None]


@pytest.mark.slow
@pytest.mark.thorough  # a browser takes long to start
def test_in_a_browser(tmp_path: Path) -> None:
    """No messages; the pointer shows the values of the row below it; the replay is in its frame."""
    from selenium.webdriver.common.action_chains import ActionChains

    folder = run_folder(tmp_path / "run", count=40, intermediate=True)
    script = "<script>window.replay={theme(){}}</script>"
    replay = f"<!doctype html><html data-ready=true><p id=shown>replayed</p>{script}"
    page = page_of(folder)
    file = tmp_path / "report.html"
    file.write_text(page.html(replay), encoding="utf-8")
    loss = next(name for name, spec in page.charts.items() if spec["title"] == "Loss")
    updates = pd.read_csv(folder / "updates.csv")
    with opened(file) as browser:
        figures = browser.find_elements("css selector", "figure[data-chart]")
        assert len(figures) == len(page.charts)
        assert all(
            figure.find_elements("css selector", "svg path")
            or figure.find_elements("css selector", "svg circle")
            for figure in figures
        )

        def hover(across: float, down: int) -> str:
            """Move the pointer over the chart, where it is now, and return the values that are shown."""
            svg = browser.find_element("css selector", f'[data-chart="{loss}"] svg')
            browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", svg)
            right = int((across - 0.5) * svg.size["width"])
            ActionChains(browser).move_to_element_with_offset(svg, right, down).perform()
            time.sleep(0.2)
            # The inner text of an element that is not laid out yet has no lines.
            tip = "const tip = document.getElementById('tip');"
            return str(
                browser.execute_script(f"{tip} return tip.getClientRects().length ? tip.innerText : ''")
            )

        for across in (0.3, 0.7):
            # A page that is still being laid out moves away from below the pointer.
            text = next(filter(None, (hover(across, down % 7) for down in range(100))))
            found = re.search(
                r"Environment steps ([\d,]+).*^loss\s+([\d.,]+)", text, re.MULTILINE | re.DOTALL
            )
            assert found, text
            steps, shown = (float(number.replace(",", "")) for number in found.groups())
            (value,) = updates.loc[updates["env_steps"] == steps, "loss"]
            assert shown == pytest.approx(value, rel=1e-5)
        browser.execute_script("document.getElementById('replay').scrollIntoView()")
        text = wait(
            browser,
            "return document.querySelector('#replay iframe')?.contentDocument"
            "?.getElementById('shown')?.textContent",
        )
        assert text == "replayed"
        before = browser.execute_script("return document.documentElement.dataset.theme")
        browser.execute_script("document.getElementById('theme').click()")
        assert browser.execute_script("return document.documentElement.dataset.theme") != before
        assert browser.execute_script("return document.documentElement.scrollWidth <= innerWidth")
        assert browser.get_log("browser") == []


@pytest.mark.slow
@pytest.mark.thorough  # a browser takes long to start
def test_long_names_fit_on_a_phone(tmp_path: Path) -> None:
    """An experiment without a title is described by its settings, long words."""
    about = "evaluation.random_starts.episodes=1000, training.exploring_starts.heading_noise_deg=45"
    trial = Trial("large", "batch", about, [read_run(run_folder(tmp_path / "seed0"))])
    file = tmp_path / "report.html"
    file.write_text(study_page("a_long_title_" * 5, tmp_path, [trial]).html(), encoding="utf-8")
    size = {"width": 320, "height": 700, "deviceScaleFactor": 1, "mobile": False}
    with opened(file) as browser:
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        wait(browser, "return innerWidth === 320")
        assert browser.execute_script("return document.documentElement.scrollWidth") <= 320
