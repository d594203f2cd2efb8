"""``dockctl map``: map of the start poses from which a policy docks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console

from dockctl.commands.options import (
    Ckpt,
    Json,
    On,
    Overrides,
    Plugins,
    PolicyArgument,
    ScenarioOption,
    Trust,
    finite,
    parse_numbers,
    print_paths,
    save_figures,
    select_policy,
)
from dockctl.console import count, make_table, numeric, print_notes, print_table, print_text
from dockctl.run_files import MAP

if TYPE_CHECKING:
    from dockctl.evaluation.success_map import SuccessMap


def map_(
    policy: PolicyArgument = None,
    ckpt: Ckpt = None,
    scenario: ScenarioOption = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    reach_m: Annotated[
        float | None,
        typer.Option(min=0, max=1000, callback=finite, help="Half-width of the grid [m]; 10 by default."),
    ] = None,
    step_m: Annotated[
        float | None,
        typer.Option(min=0.01, max=1000, callback=finite, help="Grid spacing [m]; 2 by default."),
    ] = None,
    headings: Annotated[
        str | None,
        typer.Option(metavar="DEGREES,…", help="Heading offsets [°]; 0, ±20, ±45, ±90 and 180 by default."),
    ] = None,
    on: On = None,
    json_: Json = None,
    csv: Annotated[Path | None, typer.Option(help="Write the table to this file as well.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of table and figure; the run folder, or figures/map, by default."),
    ] = None,
) -> None:
    """Run greedy episodes from a grid of starts around the first initial pose, and draw which of them dock.

    Starts at which the boat would touch an obstacle are marked as blocked and do not count.

    Example: dockctl map s3 --reach-m 6 --headings 0,20,-20
    """
    from dockctl.evaluation import success_map
    from dockctl.evaluation.outputs import Outputs
    from dockctl.evaluation.success_map import Grid
    from dockctl.reports.success_map import map_figure

    example = "angles in degrees, separated by commas, like 0,20,-20"
    offsets = None if headings is None else parse_numbers("--headings", headings, example)
    given: dict[str, Any] = {"reach_m": reach_m, "step_m": step_m, "headings_deg": offsets}
    grid = Grid(**{name: value for name, value in given.items() if value is not None})
    loaded_policy = select_policy(policy, ckpt, plugin, trust, scenario)
    outputs = Outputs.select(MAP, loaded_policy, scenario, set_ or (), out, csv)
    with Console(stderr=True).status("running episodes"):
        result = success_map(loaded_policy, scenario, grid, overrides=set_ or (), on=on)
    _print(result)
    print_notes(loaded_policy.notes_on(result.scenario, result.overrides))
    if json_:
        json_.write(result.as_json())
    caption, task = loaded_policy.caption_on(result.scenario, result.overrides), result.scenario.task
    save_figures(
        lambda: {outputs.stem: map_figure(result.table, result.plan, task, caption)}, outputs.figures
    )
    print_paths(outputs.write(result.csv))


def _print(result: SuccessMap) -> None:
    """Print the outcomes of the starts by heading offset."""
    from dockctl.analysis import success_map as analysis
    from dockctl.analysis.statistics import describe_share

    console, rows, limit = Console(), result.table, analysis.SMALL_OFFSET_DEG
    free, reach_m = analysis.free_starts(rows), analysis.half_width(rows)
    print_text(
        console,
        f"{result.policy.title_on(result.scenario, result.overrides)}:"
        f" {count(len(free), 'free start')} within ±{reach_m:g} m, {len(rows) - len(free):,} blocked",
    )
    names = ("docked", "success", "95 %\ninterval", "collision", "timeout", "success\nradius")
    table = make_table(*numeric("heading\noffset", *names))
    offsets = rows["dheading_deg"].unique()
    groups = [(f"{offset:+g}°", free[free["dheading_deg"] == offset]) for offset in offsets]
    small = analysis.within_heading(free, limit)
    for name, group in [*groups, (f"up to {limit:g}°", small), ("all", free)]:
        if not len(group):
            table.add_row(name, "no free start")
            continue
        others = [f"{(group['outcome'] == outcome).sum()}" for outcome in ("collision", "timeout")]
        radius = analysis.format_radius(analysis.success_radius(group, reach_m))
        table.add_row(name, *describe_share(int(group["docked"].sum()), len(group)), *others, radius)
    print_table(console, table)
    print_text(console, "Success radius: the largest distance up to which every free start docks.")
