"""The report of a run as one HTML page that works offline (``dockctl report``)."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

import dockctl
from dockctl.analysis.episodes import count_by_kind, summarize
from dockctl.analysis.latency import PARTS, REQUIRED, STATISTICS, verdict
from dockctl.analysis.latency import summarize as summarize_latency
from dockctl.analysis.returns import format_unit, verdicts
from dockctl.analysis.statistics import describe_share
from dockctl.analysis.success_map import (
    COLUMNS,
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.console import count
from dockctl.geometry import shown_heading
from dockctl.reading import reading
from dockctl.reports import charts
from dockctl.reports.charts import Chart
from dockctl.reports.plan_view import split_tracks
from dockctl.run_files import (
    EVALUATION,
    LATENCY,
    MAP,
    PROVENANCE,
    RECORDING,
    RETURNS,
    SCENARIO,
    TIMING_CSV,
    TRANSFER,
)
from dockctl.runs.directory import RunDirectory
from dockctl.runs.reader import Run, read_run, read_table
from dockctl.runs.results import is_outdated
from dockctl.runs.tables import EPISODE_RESULT, START_KINDS, TIMING
from dockctl.runs.tables import RETURNS as RETURNS_COLUMNS
from dockctl.scenarios.yaml_tree import read_file

FILES = ("page/theme.css", "page/report.css", "page/report.html", "page/report.js")
"""Parts of the page, in the package."""
MOST_ROWS = 40
"""Maximum number of rows in a table of episodes."""


@dataclass(frozen=True)
class Table:
    """A table of a section; `numeric` are the indices of the columns that are aligned to the right."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    numeric: Sequence[int] = ()


@dataclass
class Section:
    """A section of the page: text, tables, then charts, each with its width: "", "wide" or "tall"."""

    title: str
    text: str = ""
    tables: list[Table] = field(default_factory=list)
    charts: list[tuple[str, str]] = field(default_factory=list)


@dataclass
class Page:
    """The content of a page; `add` puts charts into it."""

    title: str
    subtitle: str
    state: str = ""
    facts: list[tuple[str, str, str]] = field(default_factory=list)
    sections: list[Section] = field(default_factory=list)
    charts: dict[str, Chart] = field(default_factory=dict)
    harbors: list[Chart] = field(default_factory=list)

    def add(self, section: Section, chart: Chart, harbor: Chart | None = None, *, size: str = "") -> None:
        """Put a chart into a section, with the harbor that it shows, if any."""
        if harbor is not None:
            if harbor not in self.harbors:
                self.harbors.append(harbor)
            chart = {**chart, "harbor": self.harbors.index(harbor)}
        name = f"c{len(self.charts)}"
        self.charts[name] = chart
        section.charts.append((name, size))

    def html(self, replay: str | None = None, reload_s: int | None = None) -> str:
        """Return the page.

        Args:
            replay: the page of the 3-D replay, which is shown in a frame.
            reload_s: time after which the page reloads itself [s].
        """
        theme, style, html, script = (
            (resources.files("dockctl.reports") / name).read_text("utf-8") for name in FILES
        )
        data = json.dumps({"charts": self.charts, "harbors": self.harbors, "reload_s": reload_s})
        packed = replay and base64.b64encode(gzip.compress(replay.encode(), mtime=0)).decode()
        environment = Environment(
            autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        return environment.from_string(html).render(
            title=self.title,
            subtitle=self.subtitle,
            state=self.state,
            facts=self.facts,
            sections=[section for section in self.sections if section.tables or section.charts],
            footer=f"dockctl {dockctl.__version__}",
            style=Markup(theme + style),
            script=Markup(script),
            data=Markup(data.replace("<", "\\u003c")),  # plain "<" could end the script element
            replay=packed,
            reload_s=reload_s,
        )


def run_page(run: Run, state: str) -> Page:
    """Return the report of a run; measurements that its current policy does not have are omitted.

    Args:
        state: whether and why training ended, in words.

    Raises:
        DockctlError: a file of the run is damaged.
    """
    page = Page(run.caption[:1].upper() + run.caption[1:], str(run.folder), state)
    if run.trajectories is not None:
        section = add_section(page, "Trajectories", f"Greedy episodes of {run.policy}.")
        tracks = split_tracks(run.trajectories)
        title = f"Trajectories of {run.policy}"
        page.add(section, *charts.path_chart(title, run.scene, tracks, run.task), size="tall")
        for chart in charts.docking_charts(tracks, run.task):
            page.add(section, chart)
    training = add_section(page, "Training")
    if run.episodes is not None:
        for chart in charts.training_charts(run.episodes, run.task):
            page.add(training, chart)
    if run.evaluations is not None:
        page.add(training, charts.evaluation_chart(run.evaluations))
    if run.updates is not None:
        updates = add_section(
            page, "Network updates", "Averages over the updates between two rows of updates.csv."
        )
        for chart in charts.update_charts(run.updates):
            page.add(updates, chart)
    _evaluation_section(page, run)
    _map_section(page, run)
    _transfer_section(page, run)
    _returns_section(page, run)
    _latency_section(page, run)
    _provenance_section(page, run)
    page.facts += _run_facts(run)
    return page


def add_section(page: Page, title: str, text: str = "") -> Section:
    """Append an empty section to the page, and return it."""
    page.sections.append(Section(title, text))
    return page.sections[-1]


def _run_facts(run: Run) -> Iterator[tuple[str, str, str]]:
    for kind, summary in summaries(run, EVALUATION).items():
        docked, rate, interval = describe_share(summary["docked"], summary["episodes"])
        yield (START_KINDS.get(kind, kind).capitalize(), rate, f"{docked}, 95 %: {interval}")
    if run.episodes is not None:
        yield "Training episodes", f"{len(run.episodes):,}", ""
    timing = read_table(run.folder / TIMING_CSV, TIMING)
    if timing is not None:
        minutes = float(timing["wall_s"].max()) / 60
        steps = f"{int(timing['env_steps'].max()):,} environment steps"
        yield "Training time", f"{minutes:,.0f} min" if minutes >= 10 else f"{minutes:.1f} min", steps


def summaries(run: Run, stem: str) -> dict[str, dict[str, Any]]:
    """Return the summary of each kind of start of an evaluation; empty if there is none."""
    table = _measured(run, stem, ("start_kind", *EPISODE_RESULT))
    if table is None:
        return {}
    period_s = _control_period_s(run)
    complete = table.astype(object).where(table.notna(), None)
    return {
        str(kind): summarize([dict(row) for _, row in rows.iterrows()], period_s)
        for kind, rows in complete.groupby("start_kind", sort=False)
    }


def _measured(run: Run, stem: str, columns: Sequence[str]) -> pd.DataFrame | None:
    """Return the table of a measurement; None if there is none of the current policy."""
    if is_outdated(run.folder, f"{stem}.json"):
        return None
    return read_table(run.folder / f"{stem}.csv", columns)


def _control_period_s(run: Run) -> float:
    path = run.folder / SCENARIO
    resolved = read_file(path, str(path)).to_python()
    with reading(path):
        return float(resolved["vessel"]["control_period_s"])


def _evaluation_section(page: Page, run: Run) -> None:
    others = sorted(run.folder.glob(f"{EVALUATION}-*.csv"))
    stems = [EVALUATION, *(path.stem for path in others)]
    section = add_section(
        page, "Evaluation", "Greedy episodes of dockctl evaluate; means over the episodes that dock."
    )
    rows, bars = [], []
    for stem in stems:
        scenario = stem.removeprefix(EVALUATION).strip("-") or run.scenario
        for kind, summary in summaries(run, stem).items():
            rows.append([scenario, START_KINDS.get(kind, kind), *summary_cells(summary)])
            bars.append(success_row(f"{scenario}: {START_KINDS.get(kind, kind)}", summary))
    if not rows:
        return
    section.tables.append(Table("", SUMMARY_COLUMNS, rows, range(2, 9)))
    page.add(
        section,
        charts.interval_chart("Success with 95 % interval", "Share docked", bars, percent=True, min=0, max=1),
        size="wide",
    )
    _failure_section(page, run)


def _failure_section(page: Page, run: Run) -> None:
    """Add the episodes of the evaluation that do not dock."""
    table = _measured(run, EVALUATION, ("start_kind", "heading_deg", *EPISODE_RESULT))
    if table is None or not len(failed := table[table["outcome"] != "docked"]):
        return
    listed = failed.head(MOST_ROWS).round(2).assign(heading_deg=failed["heading_deg"].map(shown_heading))
    columns = [name for name in FAILURE_COLUMNS if name in listed and listed[name].notna().any()]
    numeric = [i for i, name in enumerate(columns) if pd.api.types.is_numeric_dtype(listed[name])]
    rows = [[_cell(value) for value in row] for row in listed[columns].itertuples(index=False)]
    shown = "" if len(listed) == len(failed) else f"; the first {MOST_ROWS}"
    section = add_section(
        page, "Failures", f"{len(failed)} of {count(len(table), 'episode')} do not dock{shown}."
    )
    section.tables.append(Table("", [FAILURE_COLUMNS[name] for name in columns], rows, numeric))


FAILURE_COLUMNS = {
    "start_kind": "starts", "start": "number", "berth": "berth", "x_m": "x [m]", "y_m": "y [m]",
    "heading_deg": "heading [°]", "outcome": "outcome", "collided_with": "collided with", "steps": "steps",
    "distance_m": "distance at the end [m]", "contact_speed_mps": "contact speed [m/s]",
}  # fmt: skip
"""Columns of ``evaluation.csv`` in the table of failures, and their names."""
SUMMARY_COLUMNS = (
    "scenario", "starts", "docked", "success", "95 % interval", "time", "path", "control changes",
    "minimum clearance", "other outcomes",
)  # fmt: skip


def summary_cells(summary: Mapping[str, Any]) -> list[str]:
    """Return one group of an evaluation as text, for the columns `SUMMARY_COLUMNS` after the first two.

    Args:
        summary: see `dockctl.analysis.episodes.summarize`.
    """
    docked, rate, interval = describe_share(summary["docked"], summary["episodes"])
    means = summary["mean_of_docked"] or {}
    clearance = summary["least_clearance_m"]
    kinds = count_by_kind(summary["endings"]).items()
    others = [f"{number} {outcome}" for outcome, number in kinds if outcome != "docked"]
    return [
        docked, rate, interval,
        f"{means['time_s']:.1f} s" if means else "–",
        f"{means['path_length_m']:.1f} m" if means else "–",
        f"{means['control_changes']:.0%}" if means else "–",
        "–" if clearance is None else f"{clearance:.2f} m",
        ", ".join(others) or "–",
    ]  # fmt: skip


def success_row(label: str, summary: Mapping[str, Any]) -> Chart:
    """Return the success rate with its 95 % interval, as a row of a chart of intervals.

    Args:
        summary: see `dockctl.analysis.episodes.summarize`.
    """
    docked, rate, interval = describe_share(summary["docked"], summary["episodes"])
    low, high = summary["success_interval_95"]
    details = [["docked", docked], ["success", rate], ["95 % interval", interval]]
    return {
        "label": label,
        "value": summary["success"],
        "low": low,
        "high": high,
        "text": rate,
        "details": details,
    }


def _map_section(page: Page, run: Run) -> None:
    table = _measured(run, MAP, COLUMNS)
    if table is None:
        return
    free, limit = free_starts(table), half_width(table)
    straight, small = (
        format_radius(success_radius(within_heading(free, degrees), limit))
        for degrees in (0, SMALL_OFFSET_DEG)
    )
    text = (
        f"{free['docked'].sum():,} of {len(free):,} free starts dock. Success radius, up to which every free"
        f" start docks: {straight} with the heading of the pose, {small} with heading offsets up to"
        f" {SMALL_OFFSET_DEG:g}°."
    )
    page.add(
        add_section(page, "Success map", text), *charts.map_chart(table, run.scene, run.task), size="wide"
    )


def _transfer_section(page: Page, run: Run) -> None:
    section = add_section(page, "On other scenarios", "Recorded episodes of the same policy.")
    for folder in sorted((run.folder / TRANSFER).glob(f"*/{SCENARIO}")):
        if is_outdated(run.folder, (folder.parent / RECORDING).relative_to(run.folder).as_posix()):
            continue
        recording = read_run(folder.parent)
        if recording.trajectories is not None:
            tracks = split_tracks(recording.trajectories)
            name = folder.parent.name
            chart, harbor = charts.path_chart(name, recording.scene, tracks, recording.task)
            page.add(section, {**chart, "group": name}, harbor)


def _returns_section(page: Page, run: Run) -> None:
    table = _measured(run, RETURNS, RETURNS_COLUMNS)
    if table is None:
        return
    section = add_section(
        page, "Returns of behaviors", "Discounted returns under the reward of the scenario."
    )
    for unit, rows in table.groupby("distance_unit_m", sort=False):
        cells = [
            [_cell(value) for value in row]
            for row in rows[["behavior", "outcome", "steps", "return"]].itertuples(index=False)
        ]
        title = f"δd in {format_unit(float(str(unit)))}: {' '.join(verdicts(rows))}"
        section.tables.append(
            Table(title, ("behavior", "outcome", "steps", "discounted return"), cells, (2, 3))
        )


def _latency_section(page: Page, run: Run) -> None:
    samples = _measured(run, LATENCY, REQUIRED)
    if samples is None:
        return
    summary, period_ms = summarize_latency(samples), 1000 * _control_period_s(run)
    section = add_section(page, "Latency", verdict(summary, period_ms))
    rows = [
        [PARTS[part], *(f"{values[name]:.3f}" for name in STATISTICS)] for part, values in summary.items()
    ]
    section.tables.append(Table("", ("ms", *STATISTICS), rows, range(1, 6)))
    for chart in charts.latency_charts(samples, period_ms):
        page.add(section, chart)


def _provenance_section(page: Page, run: Run) -> None:
    files = [name for name in (PROVENANCE, RECORDING) if (run.folder / name).is_file()]
    if not files:
        return
    facts = RunDirectory(run.folder).read_json(files[0])
    if isinstance(policy := facts.get("policy"), dict):  # of a recording
        facts = policy
    section = add_section(page, "Provenance")
    rows = [
        [key.replace("_", " "), _described(value)]
        for key, value in facts.items()
        if value not in (None, {}, [])
    ]
    section.tables.append(Table("", (), rows))


def _described(value: Any) -> str:
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_described(item)}" for key, item in value.items())
    return " ".join(map(_described, value)) if isinstance(value, list) else str(value)


def _cell(value: Any) -> str:
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return "–"
    if isinstance(value, float | int):
        return f"{value:,.6g}".replace("-", "−")
    return str(value)
