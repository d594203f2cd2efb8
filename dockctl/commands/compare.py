"""``dockctl compare``: which of these policies docks better?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from dockctl.commands.options import Episodes, Json, Overrides, Plugins, StartSeed, Trust, save_figures
from dockctl.console import make_table, numeric, print_notes, print_table, print_text
from dockctl.run_files import FIGURES
from dockctl.runs.files import require_writable, require_writable_file, write_atomically
from dockctl.runs.results import file_stem
from dockctl.runs.tables import EVALUATION, START_KINDS, all_columns, to_csv

if TYPE_CHECKING:
    from dockctl.analysis.contrast import Compared, Contrast, Measure
    from dockctl.evaluation.compare import Comparison

FOLDER = Path(FIGURES) / "compare"


def compare(
    policies: Annotated[
        list[str],
        typer.Argument(
            metavar="POLICY",
            help="Two or more, one with --vary: run folders, checkpoints, names, or controllers like"
            " file.py:factory.",
        ),
    ],
    scenario: Annotated[
        str | None,
        typer.Option(help="Scenario to dock in, file or name; by default the scenario of the first policy."),
    ] = None,
    set_: Overrides = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KEY=VALUE",
            help="Also run each policy with this value of the scenario changed; repeatable.",
        ),
    ] = None,
    plugin: Plugins = None,
    trust: Trust = False,
    episodes: Episodes = None,
    seed: StartSeed = None,
    json_: Json = None,
    csv: Annotated[Path | None, typer.Option(help="Write one row per episode to this file.")] = None,
    out: Annotated[Path, typer.Option(help="Output folder of the figure.")] = FOLDER,
) -> None:
    """Run policies from the same starts and report how much each differs from the first.

    Success rates have Wilson intervals, and their differences have Newcombe's intervals for paired data.
    Time, path, clearance and control changes are compared over the episodes that both dock, with bootstrap
    intervals. All are 95 % intervals.

    With --vary, a single policy is compared with itself under other conditions, from the same starts:
    --vary "conditions.lidar_faults={sectors: [1, 2]}".

    Example: dockctl compare s1 s2 --scenario s2 --episodes 200
    """
    from dockctl.evaluation import compare as run
    from dockctl.evaluation import load_policy
    from dockctl.reports.compare import compare_figure

    if csv:
        require_writable_file(csv, ".csv")
    require_writable(out)
    with Console(stderr=True).status("running episodes"):
        loaded = [load_policy(policy, plugin_files=plugin or (), trust=trust) for policy in policies]
        result = run(loaded, scenario, episodes=episodes, seed=seed, overrides=set_ or (), vary=vary or ())
    _print(result)
    if csv:
        rows = result.rows()
        table = to_csv(rows, all_columns(["policy", *EVALUATION], rows))
        write_atomically(csv, table.encode())
    if json_:
        json_.write(result.as_json())
    name = result.first.scenario.name
    where = ", ".join([f"scenario {name}", *(set_ or ())])
    caption = f"{where}; the same starts for every policy, seed {result.first.seed}"
    stem = file_stem(["compare", name, *(p.file_name for p in loaded)], [*(set_ or ()), *(vary or ())])
    save_figures(lambda: {stem: compare_figure(result.table, START_KINDS, caption)}, out)


def _print(result: Comparison) -> None:
    """Print the success of each policy and its differences from the first."""
    console = Console()
    for kind in result.first.groups:
        print_table(console, _outcome_table(result, kind))
        for pair in result.contrasts:
            if pair.kind == kind:
                print_table(console, _difference_table(pair))
                counts = f"{pair.only_first} by {pair.first}, {pair.only_second} by {pair.second}"
                text = f"Docked by only one policy: {counts}; exact McNemar p = {pair.p:.2g}.\n"
                print_text(console, text, "dim")
    print_notes(note for each in result.evaluations.values() for note in each.notes)


def _outcome_table(result: Comparison, kind: str) -> Table:
    from dockctl.analysis.episodes import count_by_kind
    from dockctl.analysis.statistics import describe_share

    seeded = "" if kind == "pose" else f", seed {result.first.seed}"
    title = f"{START_KINDS[kind].capitalize()}{seeded}, scenario '{result.first.scenario.name}'"
    policy = Column("policy", no_wrap=True)
    table = make_table(
        policy, *numeric("docked", "success", "95 % interval"), Column("other outcomes"), title=title
    )
    for name, evaluation in result.evaluations.items():
        summary = evaluation.summaries[kind]
        docked, rate, interval = describe_share(summary["docked"], summary["episodes"])
        kinds = count_by_kind(summary["endings"]).items()
        others = [f"{count} {outcome}" for outcome, count in kinds if outcome != "docked"]
        table.add_row(Text(name), docked, f"[bold]{rate}[/]", interval, ", ".join(others) or "-")
    return table


def _difference_table(contrast: Contrast) -> Table:
    table = make_table(
        Column(""),
        *numeric("first", "second", "difference", "95 % interval", "pairs"),
        title=Text(f"{contrast.second} (second) against {contrast.first} (first)", "table.title"),
    )
    for measure, compared in contrast.compared.items():
        table.add_row(*_difference_cells(measure, compared))
    return table


def _difference_cells(measure: Measure, compared: Compared) -> tuple[str, ...]:
    difference = compared.difference
    value = measure.text(difference.value, signed=True)
    return (
        f"{measure.name} [{measure.unit}]".replace("[", r"\["),
        measure.text(compared.first),
        measure.text(compared.second),
        f"[bold]{value}[/]" if difference.is_clear else value,
        f"{measure.text(difference.low, signed=True)} to {measure.text(difference.high, signed=True)}",
        f"{difference.pairs:,}",
    )
