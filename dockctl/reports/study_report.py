"""The reports of a study and of a comparison (``dockctl report``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dockctl.analysis.contrast import MEASURES, SUCCESS
from dockctl.analysis.episodes import moving_average, smoothing_window
from dockctl.analysis.statistics import describe_share, wilson_interval
from dockctl.console import count
from dockctl.reading import reading
from dockctl.reports import charts
from dockctl.reports.charts import Chart
from dockctl.reports.plan_view import split_tracks
from dockctl.reports.report import (
    SUMMARY_COLUMNS,
    Page,
    Table,
    add_section,
    success_row,
    summaries,
    summary_cells,
)
from dockctl.run_files import EVALUATION
from dockctl.runs.reader import Run
from dockctl.runs.tables import START_KINDS

CURVE_POINTS = 300
"""Maximum number of points in a learning curve; a study has many curves."""


@dataclass(frozen=True)
class Trial:
    """An experiment of a study with its archived runs."""

    name: str
    group: str
    title: str
    runs: Sequence[Run]


def study_page(title: str, folder: Path, trials: Sequence[Trial]) -> Page:
    """Return the report of the archived runs of a study.

    Raises:
        DockctlError: a file of a run is damaged.
    """
    number = sum(len(trial.runs) for trial in trials)
    page = Page(title, str(folder), f"{count(len(trials), 'experiment')}, {count(number, 'run')}")
    overview = add_section(
        page, "Results", "Success of the best policies, all seeds together; circles are individual seeds."
    )
    rows: list[list[str]] = []
    bars: dict[str, list[Chart]] = {}
    for trial in trials:
        pooled = _pooled(trial)
        for kind, seeds in pooled.items():
            docked, episodes = sum(s["docked"] for s in seeds), sum(s["episodes"] for s in seeds)
            low, high = wilson_interval(docked, episodes)
            text = describe_share(docked, episodes)
            rows.append([trial.name, trial.title, START_KINDS.get(kind, kind), str(len(seeds)), *text])
            bars.setdefault(kind, []).append(
                {
                    "label": trial.name,
                    "value": docked / episodes,
                    "low": low,
                    "high": high,
                    "text": text[1],
                    "dots": [s["success"] for s in seeds],
                    "details": [
                        ["docked", text[0]],
                        ["95 % interval", text[2]],
                        *([f"seed {i}", f"{s['success']:.1%}"] for i, s in enumerate(seeds)),
                    ],
                }
            )
    for kind, entries in bars.items():
        name = START_KINDS.get(kind, kind).capitalize()
        page.add(overview, charts.interval_chart(name, "Share docked", entries, percent=True, min=0, max=1))
    columns = ("experiment", "about", "starts", "seeds", "docked", "success", "95 % interval")
    if rows:
        overview.tables.append(Table("", columns, rows, (3, 4, 5, 6)))
    for group in dict.fromkeys(trial.group for trial in trials):
        for trial in (t for t in trials if t.group == group):
            _trial_section(page, trial)
    return page


def _pooled(trial: Trial) -> dict[str, list[dict[str, Any]]]:
    """Return the summaries of the seeds by kind of start."""
    found: dict[str, list[dict[str, Any]]] = {}
    for run in trial.runs:
        for kind, summary in summaries(run, EVALUATION).items():
            found.setdefault(kind, []).append(summary)
    return found


def _trial_section(page: Page, trial: Trial) -> None:
    heading = f"{trial.name}: {trial.title}" if trial.title else trial.name
    section = add_section(
        page, heading, f"{count(len(trial.runs), 'run')}, scenario {trial.runs[0].scenario}"
    )
    for title, y, column, percent in (
        ("Share of training episodes that dock", "Share", None, True),
        ("Return", "Return of the episode", "return", False),
    ):
        lines = []
        for i, run in enumerate(trial.runs):
            if run.episodes is None:
                continue
            values = (
                (run.episodes["outcome"] == "docked").astype(float)
                if column is None
                else run.episodes[column]
            )
            kept = charts.thinned(run.episodes, CURVE_POINTS)
            mean = moving_average(values, smoothing_window(run.episodes))[kept.index]
            x = kept["env_steps"] if "env_steps" in kept else kept["episode"]
            lines.append(
                charts.series(f"seed {run.seed}", charts.TRACK_TONES[i % len(charts.TRACK_TONES)], x, mean)
            )
        if lines:
            bounds = {"percent": True, "min": 0, "max": 1} if percent else {}
            page.add(section, charts.chart(title, "Environment steps", f"{y}, moving mean", lines, **bounds))
    drawn = next((run for run in trial.runs if run.trajectories is not None), None)
    if drawn is not None and drawn.trajectories is not None:
        title, tracks = f"Trajectories of seed {drawn.seed}", split_tracks(drawn.trajectories)
        chart, harbor = charts.path_chart(title, drawn.scene, tracks, drawn.task)
        page.add(section, {**chart, "group": trial.name}, harbor)


def comparison_page(result: Mapping[str, Any], file: Path) -> Page:
    """Return the report of a comparison.

    Args:
        result: content of the JSON file of ``dockctl compare``.
        file: its path, for messages.

    Raises:
        DockctlError: it is not such a file.
    """
    with reading(file):
        policies, differences = result["policies"], result["differences"]
        first = next(iter(policies))
        page = Page(
            f"{len(policies)} policies on scenario {result['scenario']}",
            str(file),
            f"The same starts for every policy, seed {result['random_seed']}; differences from {first}.",
        )
        kinds = dict.fromkeys(kind for policy in policies.values() for kind in policy if kind in START_KINDS)
        section = add_section(page, "Success", "Wilson intervals at 95 %.")
        for kind in kinds:
            summaries = {name: policy[kind] for name, policy in policies.items() if kind in policy}
            rows = [[name, *summary_cells(summary)] for name, summary in summaries.items()]
            section.tables.append(
                Table(START_KINDS[kind].capitalize(), ("policy", *SUMMARY_COLUMNS[2:]), rows, range(1, 8))
            )
            bars = [success_row(name, summary) for name, summary in summaries.items()]
            page.add(
                section,
                charts.interval_chart(
                    START_KINDS[kind].capitalize(), "Share docked", bars, percent=True, min=0, max=1
                ),
            )
        _difference_section(page, differences)
    return page


def _difference_section(page: Page, differences: Sequence[Mapping[str, Any]]) -> None:
    section = add_section(
        page, "Paired differences", "Second policy minus first, over the same starts; intervals at 95 %."
    )
    rows = [
        [
            START_KINDS[d["starts"]],
            d["first"],
            d["second"],
            str(d["only_first_docks"]),
            str(d["only_second_docks"]),
            f"{d['mcnemar_p']:.2g}",
        ]
        for d in differences
    ]
    columns = (
        "starts",
        "first",
        "second",
        "only the first docks",
        "only the second docks",
        "exact McNemar p",
    )
    section.tables.append(Table("", columns, rows, (3, 4, 5)))
    for measure in (SUCCESS, *MEASURES):
        bars = []
        for d in differences:
            if (found := d.get(measure.column)) is not None:
                value, low, high = (measure.factor * found[key] for key in ("value", "low", "high"))
                means = [[d[which], measure.quantity(found[which])] for which in ("first", "second")]
                interval = measure.quantity(found["low"], found["high"], signed=True)
                bars.append(
                    {
                        "label": f"{d['second']}, {START_KINDS[d['starts']]}",
                        "value": value,
                        "low": low,
                        "high": high,
                        "text": measure.quantity(found["value"], signed=True),
                        "tone": "mean" if low > 0 or high < 0 else "blocked",
                        "details": [*means, ["95 % interval", interval], ["pairs", str(found["pairs"])]],
                    }
                )
        if bars:
            title = f"Difference in {measure.name}"
            page.add(
                section, charts.interval_chart(title, f"Δ {measure.name} [{measure.unit}]", bars, zero=True)
            )
