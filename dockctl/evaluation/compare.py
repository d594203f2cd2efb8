"""Let several policies sail the same episodes, and tell, draw and write how they differ."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from dockctl.agents.checkpoint import PolicyCard
from dockctl.analysis.contrast import Compared, Contrast, contrasts
from dockctl.analysis.episodes import summarize
from dockctl.console import say
from dockctl.errors import DockctlError
from dockctl.evaluation.evaluate import LEAST_WIDTH, Result, measure
from dockctl.evaluation.outputs import require_place
from dockctl.evaluation.policies import find
from dockctl.reports.compare import compare_figure
from dockctl.reports.style import house_style, save
from dockctl.runs.directory import require_writable
from dockctl.runs.files import write_atomically
from dockctl.runs.tables import EVALUATION, START_KINDS, to_csv


def compare(
    policies: Sequence[Path],
    source: str | None,
    episodes: int | None,
    seed: int | None,
    json_file: Path | None,
    csv_file: Path | None,
    out: Path,
) -> None:
    """Play every policy from the same starts; print, draw and write what came of it.

    Raises:
        DockctlError: fewer than two policies, one that is not there or does not fit the scenario, or an
            output that cannot be written.
    """
    if len(policies) < 2:
        raise DockctlError("give two policies or more: run folders, checkpoints, or names of shipped ones")
    for file in filter(None, (json_file, csv_file)):
        require_place(file)
    require_writable(out)
    trained = [find(path) for path in policies]
    names = names_of(policies, [one.card for one in trained])
    source = source or trained[0].own_scenario
    results = {
        name: measure(path, source, episodes, seed, outputs=[])
        for name, path in zip(names, policies, strict=True)
    }
    first = results[names[0]]
    rows = [{"policy": name, **row} for name, result in results.items() for row in result.rows()]
    table = pd.DataFrame(rows)
    found = list(contrasts(table))
    show(results, found)
    if csv_file:
        write_atomically(csv_file, to_csv(rows, ["policy", *EVALUATION]).encode())
    if json_file:
        write_atomically(json_file, (json.dumps(as_json(results, found), indent=2) + "\n").encode())
    caption = f"scenario {first.scenario}, the same starts for every policy, seed {first.seed}"
    with house_style():
        written = save({f"compare-{first.scenario}": compare_figure(table, START_KINDS, caption)}, out)
    for path in written:
        say(Console(), str(path))


def names_of(policies: Sequence[Path], cards: Sequence[PolicyCard]) -> list[str]:
    """A short name for each policy, no two the same."""
    names = [
        f"{card.scenario} seed {card.seed}" if path.exists() else str(path)
        for path, card in zip(policies, cards, strict=True)
    ]
    longer = [
        path.resolve().name if names.count(name) > 1 else name
        for path, name in zip(policies, names, strict=True)
    ]
    return [
        f"{name} ({longer[: i + 1].count(name)})" if longer.count(name) > 1 else name
        for i, name in enumerate(longer)
    ]


def as_json(results: dict[str, Result], found: Sequence[Contrast]) -> dict[str, Any]:
    """Everything that was measured but the episodes themselves."""
    first = next(iter(results.values()))
    return {
        "scenario": first.scenario,
        "random_seed": first.seed,
        "policies": {
            name: {
                "policy": {"file": str(result.policy), **result.card.facts()},
                **{
                    kind: summarize([e.row() for e in group], result.control_period_s)
                    for kind, group in result.groups.items()
                },
            }
            for name, result in results.items()
        },
        "differences": [
            {
                "starts": one.kind,
                "first": one.first,
                "second": one.second,
                "only_first_docks": one.only_first,
                "only_second_docks": one.only_second,
                "mcnemar_p": one.p,
                **{
                    each.measure.column: {
                        "first": each.first,
                        "second": each.second,
                        **asdict(each.difference),
                    }
                    for each in (one.success, *one.docked)
                },
            }
            for one in found
        ],
    }


def show(results: dict[str, Result], found: Sequence[Contrast]) -> None:
    """Print who docks how often, and how each policy differs from the first."""
    console = Console()
    console.width = max(console.width, LEAST_WIDTH)
    first = next(iter(results.values()))
    for kind in first.groups:
        seeded = "" if kind == "pose" else f", seed {first.seed}"
        console.print(_endings_table(f"{START_KINDS[kind].capitalize()}{seeded}", kind, results))
        for one in found:
            if one.kind == kind:
                console.print(_difference_table(one))
                say(
                    console,
                    f"Docked by one alone: {one.only_first} by {one.first}, {one.only_second} by "
                    f"{one.second}; exact McNemar p = {one.p:.2g}.\n",
                    "dim",
                )


def _endings_table(title: str, kind: str, results: dict[str, Result]) -> Table:
    table = Table(
        title=f"{title}, scenario '{next(iter(results.values())).scenario}'",
        title_justify="left",
        header_style="bold",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("policy", overflow="fold")
    for name in ("docked", "success", "95 % interval"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("other endings", overflow="fold")
    for name, result in results.items():
        summary = summarize([e.row() for e in result.groups[kind]], result.control_period_s)
        low, high = summary["success_interval_95"]
        others = [f"{count} {ending}" for ending, count in summary["endings"].items() if ending != "docked"]
        table.add_row(
            Text(name),
            f"{summary['docked']} of {summary['episodes']}",
            f"[bold]{summary['success']:.1%}[/]",
            f"{low:.1%} to {high:.1%}",
            ", ".join(others) or "-",
        )
    return table


def _difference_table(one: Contrast) -> Table:
    table = Table(
        title=Text(f"{one.second} against {one.first}", "table.title"),
        title_justify="left",
        header_style="bold",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("", no_wrap=True)
    for name in (one.first, one.second):
        table.add_column(Text(name), justify="right", overflow="fold")
    for name in ("difference", "95 % interval", "episodes"):
        table.add_column(name, justify="right", no_wrap=True)
    for each in (one.success, *one.docked):
        table.add_row(*_difference_cells(each))
    return table


def _difference_cells(each: Compared) -> tuple[str, ...]:
    measure, difference = each.measure, each.difference
    value = measure.text(difference.value, signed=True)
    return (
        f"{measure.name} [{measure.unit}]".replace("[", r"\["),
        measure.text(each.first),
        measure.text(each.second),
        f"[bold]{value}[/]" if difference.is_clear else value,
        f"{measure.text(difference.low, signed=True)} to {measure.text(difference.high, signed=True)}",
        f"{difference.pairs:,}",
    )
