"""``dockctl envelope``: how often a policy docks as weather, starts, noise or delay grow."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    print_paths,
    save_figures,
    select_policy,
)
from dockctl.console import make_table, numeric, print_notes, print_table, print_text
from dockctl.run_files import ENVELOPE
from dockctl.runs.tables import ENVELOPE as COLUMNS
from dockctl.runs.tables import to_csv

if TYPE_CHECKING:
    from dockctl.evaluation.envelope import Envelope


def envelope(
    policy: PolicyArgument = None,
    ckpt: Ckpt = None,
    scenario: ScenarioOption = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    factors: Annotated[
        str | None,
        typer.Option(
            metavar="FACTOR,…", help="Some of distance, heading, wind, current, noise, delay; all by default."
        ),
    ] = None,
    episodes: Annotated[
        int, typer.Option(min=1, max=100_000, help="Random starts for each value of a factor.")
    ] = 100,
    on: On = None,
    json_: Json = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder of table and figure; the run folder, or figures/envelope, by default."),
    ] = None,
) -> None:
    """Run greedy episodes while one factor grows at a time, and draw how often the policy docks.

    The factors are the offsets in position and heading of the start, wind and current, both from any
    direction, sensor noise, and actuator delay.

    Example: dockctl envelope s3 --factors wind,current --episodes 20
    """
    from dockctl.evaluation.envelope import FACTORS
    from dockctl.evaluation.envelope import envelope as run
    from dockctl.evaluation.outputs import Outputs
    from dockctl.reports.envelope import envelope_figure

    given = select_policy(policy, ckpt, plugin, trust, scenario)
    outputs = Outputs.select(ENVELOPE, given, scenario, set_ or (), out)
    chosen = [*FACTORS] if factors is None else [name.strip() for name in factors.split(",")]
    with Console(stderr=True).status("running episodes"):
        result = run(given, scenario, factors=chosen, episodes=episodes, overrides=set_ or (), on=on)
    _print(result)
    print_notes(given.notes_on(result.scenario, result.overrides))
    if json_:
        json_.write(result.as_json())
    labels = {name: factor.label for name, factor in FACTORS.items()}
    caption = given.caption_on(result.scenario, result.overrides)
    save_figures(lambda: {outputs.stem: envelope_figure(result.table, labels, caption)}, outputs.figures)
    print_paths(outputs.write(to_csv(result.rows, COLUMNS)))


def _print(result: Envelope) -> None:
    """Print the outcomes of each value of each factor."""
    from dockctl.analysis.statistics import describe_share

    print_text(Console(), result.policy.title_on(result.scenario, result.overrides))
    table = make_table("factor", *numeric("docked", "success", "95 %\ninterval", "collision", "timeout"))
    for row in result.rows:
        share = describe_share(int(row["docked"] or 0), int(row["episodes"] or 0))
        factor = f"{row['factor']} {row['value']:g}"
        table.add_row(factor, *share, str(row["collision"]), str(row["timeout"]))
    print_table(Console(), table)
