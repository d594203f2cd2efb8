"""``dockctl latency``: how long a decision takes on this machine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from dockctl.commands.options import (
    DEFAULT_SCENARIO,
    Ckpt,
    Outputs,
    Plugins,
    PolicyOption,
    Trust,
    save_figures,
    select_policy,
)
from dockctl.console import make_table, numeric, print_text, table_console
from dockctl.errors import DockctlError
from dockctl.runs.directory import RUNS, RunDirectory
from dockctl.runs.results import write_measurement

if TYPE_CHECKING:
    from dockctl.evaluation.policies import LoadedPolicy


def latency(
    ckpt: Ckpt = None,
    policy: PolicyOption = None,
    plugin: Plugins = None,
    trust: Trust = False,
    scenario: Annotated[
        str | None, typer.Option(help="Scenario file or name; the policy's own, or s3, by default.")
    ] = None,
    decisions: Annotated[
        int, typer.Option(min=10, max=1_000_000, help="Decisions to time at least, in complete episodes.")
    ] = 500,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of the results; the run's figures, or figures/latency, by default."),
    ] = None,
) -> None:
    """Time the LiDAR scan, the observation and the forward pass of greedy decisions.

    Without any run, a new network with random weights is timed, which takes as long as a trained one.

    Writes a histogram (PNG, SVG), every sample (CSV) and the summary (JSON).

    Example: dockctl latency --ckpt runs/s3/20250101-120000-seed0
    """
    from dockctl.analysis.latency import verdict
    from dockctl.evaluation.latency import latency as run
    from dockctl.reports.latency import latency_figure

    given = _policy(ckpt, policy, scenario, plugin, trust)
    outputs = Outputs.select("latency", given, scenario, out, None)
    folder, stem = outputs.figures, outputs.stem
    with Console(stderr=True).status("timing decisions"):
        result = run(given, scenario, decisions)
    console, subtitle = table_console(), f"{result.subject}; {len(result.samples):,} decisions"
    print_text(console, f"Timed: {subtitle}")
    console.print(_table(result.summary))
    print_text(console, verdict(result.summary, result.control_period_ms))
    period = result.control_period_ms
    save_figures(lambda: {stem: latency_figure(result.samples, subtitle, period)}, folder)
    csv = result.samples.to_csv(index_label="decision", float_format="%.6g", lineterminator="\n")
    for path in write_measurement(folder / stem, csv, result.as_json()):
        print_text(console, str(path))


def _policy(
    ckpt: Path | None, policy: str | None, scenario: str | None, plugin: list[Path] | None, trust: bool
) -> LoadedPolicy:
    """Return the given policy, that of the latest run, or a new network if there is no run."""
    from dockctl.evaluation.policies import untrained

    if ckpt is None and policy is None:
        try:
            ckpt = RunDirectory.latest(RUNS).path
        except DockctlError:
            return untrained(scenario or DEFAULT_SCENARIO)
    return select_policy(ckpt, policy, plugin, trust, scenario)


def _table(summary: dict[str, dict[str, float]]) -> Table:
    from dockctl.analysis.latency import PARTS, STATISTICS

    table = make_table("ms", *numeric(*STATISTICS))
    for part, row in summary.items():
        table.add_row(PARTS[part], *(f"{row[name]:.3f}" for name in STATISTICS))
    return table
