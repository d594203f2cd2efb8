"""``dockctl latency``: how long a decision takes on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table

from dockctl.commands.options import (
    Ckpt,
    Json,
    Overrides,
    Plugins,
    PolicyArgument,
    ScenarioOption,
    Trust,
    print_paths,
    save_figures,
    select_policy,
)
from dockctl.console import make_table, numeric, print_table, print_text
from dockctl.runs.results import write_measurement


def latency(
    policy: PolicyArgument = None,
    ckpt: Ckpt = None,
    scenario: ScenarioOption = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    decisions: Annotated[
        int,
        typer.Option(
            min=10, max=1_000_000, help="Minimum number of decisions to time, in complete episodes."
        ),
    ] = 500,
    json_: Json = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results; the run's figures, or figures/latency, by default."),
    ] = None,
) -> None:
    """Time the LiDAR scan, the observation, the forward pass, and supervisor or planner of greedy decisions.

    Writes a histogram (PNG, SVG), every sample (CSV) and the summary (JSON).

    Example: dockctl latency s3 --decisions 100
    """
    from dockctl.analysis.latency import verdict
    from dockctl.evaluation.latency import latency as run
    from dockctl.evaluation.outputs import Outputs
    from dockctl.reports.latency import latency_figure

    given = select_policy(policy, ckpt, plugin, trust, scenario)
    outputs = Outputs.select("latency", given, scenario, set_ or (), out)
    folder, stem = outputs.figures, outputs.stem
    with Console(stderr=True).status("timing decisions"):
        result = run(given, scenario, decisions, overrides=set_ or ())
    console, subtitle = Console(), f"{result.subject}; {len(result.samples):,} decisions"
    print_text(console, f"Timed: {subtitle}")
    print_table(console, _table(result.summary))
    print_text(console, verdict(result.summary, result.control_period_ms))
    if json_:
        json_.write(result.as_json())
    period = result.control_period_ms
    save_figures(lambda: {stem: latency_figure(result.samples, subtitle, period)}, folder)
    csv = result.samples.to_csv(index_label="decision", float_format="%.6g", lineterminator="\n")
    print_paths(write_measurement(folder / stem, csv, result.as_json()))


def _table(summary: dict[str, dict[str, float]]) -> Table:
    from dockctl.analysis.latency import PARTS, STATISTICS

    table = make_table("ms", *numeric(*STATISTICS))
    for part, row in summary.items():
        table.add_row(PARTS[part], *(f"{row[name]:.3f}" for name in STATISTICS))
    return table
