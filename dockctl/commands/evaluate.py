"""``dockctl evaluate``: how well does a policy dock?"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from dockctl.commands.options import (
    Ckpt,
    Episodes,
    Json,
    On,
    Overrides,
    Plugins,
    PolicyArgument,
    Poses,
    ScenarioOption,
    StartSeed,
    Trust,
    finite,
    parse_pose,
    print_paths,
    select_policy,
)
from dockctl.console import make_table, numeric, print_notes, print_table, print_text
from dockctl.runs.files import require_writable_file, write_atomically
from dockctl.runs.tables import START_KINDS

if TYPE_CHECKING:
    from dockctl.evaluation.evaluate import Evaluation

BELOW_MINIMUM = 1
MEANS = (
    ("mean time", "time_s", "{:.1f} s"),
    ("mean path", "path_length_m", "{:.1f} m"),
    ("mean final δd", "distance_m", "{:.2f} m"),
    ("mean final |δψ|", "heading_error_deg", "{:.1f}°"),
    ("mean final speed", "speed_mps", "{:.3f} m/s"),
    ("mean control changes", "control_changes", "{:.0%} of the steps"),
    ("mean propeller change", "propeller_change_n", "{:.1f} N per step"),
    ("mean rudder change", "rudder_change_deg", "{:.1f}° per step"),
)
"""What is printed for the docked episodes: name, key of the summary, format."""


def evaluate(
    policy: PolicyArgument = None,
    ckpt: Ckpt = None,
    scenario: ScenarioOption = None,
    set_: Overrides = None,
    plugin: Plugins = None,
    trust: Trust = False,
    episodes: Episodes = None,
    seed: StartSeed = None,
    on: On = None,
    min_success: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1,
            callback=finite,
            help="Exit with 1 if the success rate from the evaluation poses or the random starts is lower.",
        ),
    ] = None,
    json_: Json = None,
    csv: Annotated[Path | None, typer.Option(help="Write one row per episode to this file.")] = None,
    pose: Poses = None,
    recorded: Annotated[
        str | None,
        typer.Option(
            "--record",
            metavar="[DIR]",
            help="Also write every step of the episodes from the poses, for dockctl plot; by default to"
            " transfer/<scenario>/ in the run folder, or below figures/evaluate/.",
        ),
    ] = None,
) -> None:
    """Run greedy episodes from the evaluation poses and from random starts around the initial poses.

    The result is also stored in the run folder of a checkpoint, except with --pose. Its file names include
    the scenario, if it is not the policy's own, and the values set with --set.

    Example: dockctl evaluate s3 --episodes 200 --min-success 0.9
    """
    from dockctl.evaluation import evaluate as run
    from dockctl.evaluation.outputs import recording_folder, store
    from dockctl.sim.starts import UNREACHABLE

    poses = [parse_pose(text) for text in pose or ()]
    given = select_policy(policy, ckpt, plugin, trust, scenario)
    if csv:
        require_writable_file(csv, ".csv")
    folder = None if recorded is None else recording_folder(recorded, given, scenario, set_ or ())
    with Console(stderr=True).status("running episodes"):
        result = run(
            given,
            scenario,
            episodes=episodes,
            seed=seed,
            overrides=set_ or (),
            poses=poses,
            record=bool(folder),
            on=on,
        )
    table = result.csv()
    if csv:
        write_atomically(csv, table.encode())
    if json_:
        json_.write(result.as_json())
    if not poses and not store(result, table) and result.policy.run:
        note = f"note: {result.policy.run.path} is read-only, so the result is not stored in it"
        print_text(Console(stderr=True), note)
    console = Console()
    helpers = ", with a supervisor" * result.supervised + ", with a planner" * result.planned
    print_text(console, given.title_on(result.scenario, result.overrides) + helpers)
    if "pose" in result.groups:
        print_table(console, _episode_table(result))
    print_table(console, _summary_table(result))
    if folder and result.recording:
        result.recording.write(folder)
        print_paths([folder])
    print_notes(result.notes)
    if result.rejected_draws:
        note = f"{result.rejected_draws} poses drawn for the random starts {UNREACHABLE}, and were redrawn"
        print_text(Console(stderr=True), f"note: {note}")
    if min_success is not None and result.lowest_success < min_success:
        too_low = f"success {result.lowest_success:.0%} is below the required {min_success:.0%}"
        print_text(Console(stderr=True), too_low, "red")
        raise typer.Exit(BELOW_MINIMUM)


def _episode_table(result: Evaluation) -> Table:
    from dockctl.analysis.episodes import describe_outcome
    from dockctl.geometry import pose_label

    units = {"time": "s", "δd": "m", "δψ": "°", "speed": "m/s", "path": "m", "clearance": "m"}
    table = make_table(
        Column("start\n[dim]x m, y m, °", no_wrap=True),
        Column("outcome", overflow="fold"),
        *numeric(*(f"{name}\n[dim]{unit}" for name, unit in units.items()), "control\nchanges"),
        title=START_KINDS["pose"].capitalize(),
    )
    for episode in result.groups["pose"]:
        x, y, heading = episode.start.eta
        row = episode.row()
        table.add_row(
            pose_label(x, y, math.degrees(heading)),
            Text(describe_outcome(row), "green" if episode.docked else "red"),
            f"{episode.steps * result.control_period_s:g}",
            f"{row['distance_m']:.2f}",
            f"{row['heading_error_deg']:+.1f}",
            f"{row['speed_mps']:.3f}",
            f"{row['path_length_m']:.1f}",
            f"{episode.clearance_m:.2f}",
            f"{episode.control_changes:.0%}",
        )
    return table


def _summary_table(result: Evaluation) -> Table:
    table = make_table("")
    for kind in result.summaries:
        seeded = "" if kind == "pose" else f", seed {result.seed}"
        table.add_column(START_KINDS[kind] + seeded, justify="right")
    columns = [_summary_cells(summary) for summary in result.summaries.values()]
    fullest_first = sorted(columns, key=len, reverse=True)  # so that its rows keep their order
    for name in dict.fromkeys(name for cells in fullest_first for name in cells):
        table.add_row(name, *(cells.get(name, "-") for cells in columns))
    return table


def _summary_cells(summary: dict[str, Any]) -> dict[str, str]:
    from dockctl.analysis.episodes import count_by_kind
    from dockctl.analysis.statistics import describe_share

    docked, rate, interval = describe_share(summary["docked"], summary["episodes"])
    outcomes = count_by_kind(summary["endings"])
    clearance, means = summary["least_clearance_m"], summary["mean_of_docked"] or {}
    contact = summary["contact_speed_mps"]
    at_clearance = summary["success_at_clearance_m"] or {}
    cells = {
        "docked": docked,
        "success": f"[bold]{rate}[/]",
        "95 % interval": interval,
        **{f"success with {least} m clear": _share(given) for least, given in at_clearance.items()},
        **{kind: str(count) for kind, count in outcomes.items() if kind != "docked"},
        "minimum clearance": "-" if clearance is None else f"{clearance:.2f} m",
        **({"contact speed": f"mean {contact['mean']:.2f}, max {contact['max']:.2f} m/s"} if contact else {}),
    }
    return cells | {name: form.format(means[key]) for name, key, form in MEANS if key in means}


def _share(success: dict[str, Any]) -> str:
    low, high = success["success_interval_95"]
    return f"{success['success']:.1%} ({low:.1%} to {high:.1%})"
