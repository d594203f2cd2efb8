"""``dockctl returns``: which behavior does the reward of a scenario favor?"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from dockctl.commands.options import (
    Ckpt,
    Json,
    Overrides,
    Plugins,
    PolicyArgument,
    ScenarioOption,
    Trust,
    parse_numbers,
    print_paths,
    save_figures,
    select_policy,
)
from dockctl.console import make_table, numeric, print_table, print_text
from dockctl.errors import DockctlError
from dockctl.run_files import RETURNS

if TYPE_CHECKING:
    from dockctl.evaluation.returns import Returns


def returns(
    policy: PolicyArgument = None,
    ckpt: Ckpt = None,
    scenario: ScenarioOption = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    units: Annotated[
        str,
        typer.Option(metavar="METERS,…", help="Units of the distance in the reward [m]."),
    ] = "20,1",
    json_: Json = None,
    csv: Annotated[Path | None, typer.Option(help="Write the table to this file as well.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of table and figure; the run folder, or figures/returns, by default."),
    ] = None,
) -> None:
    """Compare the discounted returns of docking, colliding and loitering.

    The return of docking is taken from a greedy episode of the policy; the other behaviors apply constant
    commands. All start at the first initial pose, and the reward is computed with each distance unit, and
    per step as in the training: with `training.action_repeat: 2`, every two control periods. The conditions
    are those of the training, and neither a supervisor nor a planner acts.

    Example: dockctl returns s3 --units 20
    """
    from dockctl.evaluation.outputs import Outputs
    from dockctl.evaluation.returns import returns as run
    from dockctl.reports.returns import returns_figure

    units_m = parse_units(units)
    loaded_policy = select_policy(policy, ckpt, plugin, trust, scenario)
    outputs = Outputs.select(RETURNS, loaded_policy, scenario, set_ or (), out, csv)
    with Console(stderr=True).status("simulating behaviors"):
        result = run(loaded_policy, scenario, units_m, overrides=set_ or ())
    _print(result)
    if json_:
        json_.write(result.as_json())
    gamma = result.scenario.training.gamma
    changed = "".join(f", {override}" for override in set_ or ())
    which = f"scenario {result.scenario.name}{changed}, {loaded_policy.caption}"
    caption = f"{which}; discounted by {gamma:g} per step"
    save_figures(lambda: {outputs.stem: returns_figure(result.table, caption)}, outputs.figures)
    print_paths(outputs.write(result.csv))


def parse_units(text: str) -> tuple[float, ...]:
    """Read distance units [m], like ``20,1``.

    Raises:
        DockctlError: they are not positive numbers, or one is repeated.
    """
    expected = "different lengths in meters, separated by commas, like 20,1"
    units = parse_numbers("--units", text, expected)
    if len({*units}) < len(units) or not all(0 < unit < math.inf for unit in units):
        raise DockctlError(f"--units '{text}': expected {expected}")
    return units


def _print(result: Returns) -> None:
    """Print the returns with every unit, highest first, and the conclusions."""
    from dockctl.analysis.returns import format_unit, verdicts

    console, gamma = Console(), result.scenario.training.gamma
    print_text(
        console,
        f"Discounted returns on scenario '{result.scenario.name}' (gamma {gamma:g}); docking is the greedy"
        f" episode of {result.policy.description}",
    )
    for unit, rows in result.table.groupby("distance_unit_m", sort=False):
        title = f"δd in {format_unit(float(str(unit)))}"
        table = make_table("behavior", *numeric("ends", "time", "return"), title=title)
        for _, row in rows.sort_values("return", ascending=False).iterrows():
            table.add_row(row["behavior"], row["outcome"], f"{row['time_s']:g} s", f"{row['return']:,.0f}")
        print_table(console, table)
        for verdict in verdicts(rows):
            print_text(console, verdict)
