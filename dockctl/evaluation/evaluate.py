"""An evaluation: find the policy and its scenario, play, store, and show."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from dockctl.agents.checkpoint import PolicyCard
from dockctl.analysis.episodes import ending, summarize
from dockctl.console import say
from dockctl.envs.vector import DockingVectorEnv
from dockctl.evaluation.outputs import require_place
from dockctl.evaluation.policies import find
from dockctl.evaluation.rollout import Episode
from dockctl.evaluation.starts import judging_starts, player, testing_starts
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import write_atomically
from dockctl.runs.tables import EVALUATION, START_KINDS, Value, to_csv
from dockctl.sim.world import build_worlds

MEANS = (
    ("mean time", "time_s", "{:.1f} s"),
    ("mean path", "path_length_m", "{:.1f} m"),
    ("mean final δd", "distance_m", "{:.2f} m"),
    ("mean final |δψ|", "heading_error_deg", "{:.1f}°"),
    ("mean final speed", "speed_mps", "{:.3f} m/s"),
    ("mean control changes", "control_changes", "{:.0%} of the steps"),
)
"""What is shown of the docked episodes: name, key of the summary, format."""

LONGEST_NAME = 150
LEAST_WIDTH = 80
"""Columns that the tables take; a narrower terminal breaks their lines, and no number is cut short."""


@dataclass(frozen=True, eq=False)
class Result:
    """The episodes of an evaluation and what was evaluated where.

    Attributes:
        policy: JSON file of the policy.
        run: the run folder that the policy lies in, if it does.
        elsewhere: whether the scenario is another than that of the run.
        overrides: values that were set in it, ``key=value``.
        seed: of the random starts.
        groups: the episodes by the sort of their starts, keys of `START_KINDS`.
    """

    policy: Path
    card: PolicyCard
    run: RunDirectory | None
    scenario: str
    elsewhere: bool
    overrides: tuple[str, ...]
    seed: int
    control_period_s: float
    groups: dict[str, list[Episode]]

    @property
    def stem(self) -> str:
        """Name of the result's files in the run folder."""
        changes = [re.sub(r"[^\w.=-]+", "_", override) for override in self.overrides]
        place = [self.scenario] if self.elsewhere or changes else []
        return "-".join(["evaluation", *place, *changes])[:LONGEST_NAME]

    @property
    def least_success(self) -> float:
        """The lowest success of the sorts of starts."""
        return min(sum(e.docked for e in group) / len(group) for group in self.groups.values())

    def rows(self) -> list[dict[str, Value]]:
        """Columns `dockctl.runs.tables.EVALUATION`."""
        return [
            {
                "start_kind": kind,
                "start": number,
                "berth": episode.start.berth,
                "x_m": episode.start.eta[0],
                "y_m": episode.start.eta[1],
                "heading_deg": math.degrees(episode.start.eta[2]),
                **episode.row(),
                "time_s": episode.steps * self.control_period_s,
            }
            for kind, episodes in self.groups.items()
            for number, episode in enumerate(episodes)
        ]

    def as_json(self) -> dict[str, Any]:
        return {
            "policy": {"file": str(self.policy), **self.card.facts()},
            "scenario": self.scenario,
            "set": list(self.overrides),
            "random_seed": self.seed,
            **{
                START_KINDS[kind].replace(" ", "_").replace("-", "_"): summarize(
                    [e.row() for e in group], self.control_period_s
                )
                for kind, group in self.groups.items()
            },
            "episodes": self.rows(),
        }


def measure(
    ckpt: Path | None,
    source: str | None,
    episodes: int | None,
    seed: int | None,
    outputs: Sequence[Path],
    overrides: Sequence[str] = (),
) -> Result:
    """Play the episodes of an evaluation.

    Raises:
        DockctlError: there is no policy, it does not fit the scenario, or an output cannot be written.
    """
    trained = find(ckpt)
    card = trained.card
    for path in outputs:
        require_place(path)
    loaded = trained.scenario(source, overrides)
    scenario, starts = loaded.scenario, loaded.scenario.evaluation.random_starts
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    env = DockingVectorEnv(loaded, 1, worlds=worlds)
    trained.require_fit(env)
    seed = starts.seed if seed is None else seed
    count = starts.episodes if episodes is None else episodes
    drawn = [*judging_starts(scenario, worlds), *testing_starts(scenario, worlds, count, seed)]
    with Console(stderr=True).status(f"{len(drawn)} episodes on '{scenario.name}'"):
        played = player(loaded, worlds, drawn)(trained.policy)
    kinds = dict.fromkeys(start.kind for start in drawn)
    return Result(
        policy=trained.file,
        card=card,
        run=trained.run,
        scenario=scenario.name,
        elsewhere=source is not None and trained.is_elsewhere(scenario),
        overrides=tuple(overrides),
        seed=seed,
        control_period_s=scenario.vessel.control_period_s,
        groups={kind: [episode for episode in played if episode.start.kind == kind] for kind in kinds},
    )


def store(result: Result, json_file: Path | None, csv_file: Path | None) -> None:
    """Write the files that were asked for, and the run folder's own.

    Raises:
        DockctlError: one cannot be written.
    """
    as_json = (json.dumps(result.as_json(), indent=2) + "\n").encode()
    as_csv = to_csv(result.rows(), EVALUATION).encode()
    if json_file:
        write_atomically(json_file, as_json)
    if csv_file:
        write_atomically(csv_file, as_csv)
    if result.run is None:
        return
    if not os.access(result.run.path, os.W_OK):
        say(Console(stderr=True), f"note: {result.run.path} is read-only, the result is not stored in it")
        return
    write_atomically(result.run.path / f"{result.stem}.csv", as_csv)
    write_atomically(result.run.path / f"{result.stem}.json", as_json)


def show(result: Result) -> None:
    """Print what came of it."""
    console, card = Console(), result.card
    console.width = max(console.width, LEAST_WIDTH)
    say(
        console,
        f"Policy {result.policy} (trained on '{card.scenario}', seed {card.seed}, {card.env_steps:,} steps)"
        f" on scenario '{result.scenario}'{''.join(f', {change}' for change in result.overrides)}",
    )
    if "pose" in result.groups:
        console.print(_episode_table(result.groups["pose"], result.control_period_s))
    console.print(_summary_table(result))


def _episode_table(episodes: Sequence[Episode], control_period_s: float) -> Table:
    table = Table(title="Test poses", title_justify="left", header_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("start\n[dim]x m, y m, °", no_wrap=True)
    table.add_column("ending", overflow="fold", min_width=10)
    for name, unit in (
        ("time", "s"), ("δd", "m"), ("δψ", "°"), ("speed", "m/s"), ("path", "m"), ("gap", "m"), ("turns", ""),
    ):  # fmt: skip
        table.add_column(f"{name}\n[dim]{unit}", justify="right", no_wrap=True)
    for episode in episodes:
        x, y, heading = episode.start.eta
        row = episode.row()
        table.add_row(
            f"{x:g}, {y:g}, {math.degrees(heading):.4g}",
            f"[{'green' if episode.docked else 'red'}]{ending(row)}[/]",
            f"{episode.steps * control_period_s:g}",
            f"{row['distance_m']:.2f}",
            f"{row['heading_error_deg']:+.1f}",
            f"{row['speed_mps']:.3f}",
            f"{row['path_length_m']:.1f}",
            f"{episode.clearance_m:.2f}",
            f"{episode.control_changes:.0%}",
        )
    return table


def _summary_table(result: Result) -> Table:
    table = Table(header_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("")
    columns = []
    for kind, episodes in result.groups.items():
        table.add_column(
            START_KINDS[kind] + ("" if kind == "pose" else f", seed {result.seed}"), justify="right"
        )
        columns.append(_summary_cells(summarize([e.row() for e in episodes], result.control_period_s)))
    for name in dict.fromkeys(name for cells in columns for name in cells):
        table.add_row(name, *(cells.get(name, "-") for cells in columns))
    return table


def _summary_cells(summary: dict[str, Any]) -> dict[str, str]:
    low, high = summary["success_interval_95"]
    clearance, means = summary["least_clearance_m"], summary["mean_of_docked"] or {}
    cells = {
        "docked": f"{summary['docked']} of {summary['episodes']}",
        "success": f"[bold]{summary['success']:.1%}[/]",
        "95 % interval": f"{low:.1%} to {high:.1%}",
        **{kind: str(count) for kind, count in summary["endings"].items() if kind != "docked"},
        "least clearance": "-" if clearance is None else f"{clearance:.2f} m",
    }
    for name, key, form in MEANS:
        if key in means:
            cells[name] = form.format(means[key])
    return cells
