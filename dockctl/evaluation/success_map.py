"""Play from a grid of starts, store, draw and show where a policy docks."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from dockctl.analysis.statistics import wilson_interval
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.console import say
from dockctl.envs.vector import DockingVectorEnv
from dockctl.errors import DockctlError
from dockctl.evaluation.outputs import Places
from dockctl.evaluation.policies import Trained, find
from dockctl.evaluation.rollout import Episode
from dockctl.evaluation.starts import player, pose_check
from dockctl.reports.style import house_style, save
from dockctl.reports.success_map import map_figure
from dockctl.runs.tables import MAP, Value, to_csv
from dockctl.scenarios.loader import LoadedScenario
from dockctl.sim.starts import given_start, own_site
from dockctl.sim.world import World, build_worlds

Floats = NDArray[np.float64]

MOST_STARTS = 100_000
FARTHEST_DEG = 360.0


@dataclass(frozen=True)
class Grid:
    """Offsets of starts from a pose: a square of `reach_m` around it every `step_m`, for each heading."""

    reach_m: float
    step_m: float
    headings_deg: tuple[float, ...]

    @classmethod
    def of(cls, reach_m: float, step_m: float, headings: str) -> Self:
        """Read the headings from text, like ``0,20,-20``.

        Raises:
            DockctlError: they are no list of different angles, or the grid is too large.
        """
        try:
            angles = tuple(float(part) for part in headings.split(","))
        except ValueError:
            raise DockctlError(
                f"--headings '{headings}': give angles in degrees with commas, like 0,20,-20"
            ) from None
        if len({angle % 360 for angle in angles}) < len(angles) or not all(
            abs(angle) <= FARTHEST_DEG for angle in angles
        ):
            raise DockctlError(f"--headings '{headings}': the angles must differ and lie within ±360")
        grid = cls(reach_m, step_m, angles)
        if (count := len(angles) * len(grid.places) ** 2) > MOST_STARTS:
            raise DockctlError(
                f"the map would take {count:,} starts, more than {MOST_STARTS:,}: take a larger --step-m"
            )
        return grid

    @property
    def places(self) -> Floats:
        """Offsets along one axis [m], with zero in their middle."""
        count = math.floor(self.reach_m / self.step_m + 1e-9)
        return self.step_m * np.arange(-count, count + 1, dtype=np.float64)

    def offsets(self, heading_deg: float) -> Floats:
        """Rows dx [m], dy [m], turn [°] of all starts of one heading."""
        dx, dy = np.meshgrid(self.places, self.places, indexing="ij")
        return np.column_stack([dx.ravel(), dy.ravel(), np.full(dx.size, heading_deg)])


def chart(ckpt: Path | None, source: str | None, grid: Grid, csv: Path | None, out: Path | None) -> None:
    """Map the policy `ckpt` on a scenario: play, store table and figure, and print a summary.

    Raises:
        DockctlError: there is no such policy or scenario, they do not fit, no start is free, or a file
            cannot be written.
    """
    trained = find(ckpt)
    loaded = trained.scenario(source)
    places = Places.of("map", trained, loaded.scenario, source, out, csv)
    worlds = build_worlds(loaded.scenario, loaded.base_dir)
    trained.require_fit(DockingVectorEnv(loaded, 1, worlds=worlds))
    text = to_csv(measure(trained, loaded, worlds, grid), MAP)
    table = pd.read_csv(io.StringIO(text), keep_default_na=False, na_values=[""])
    if table["blocked"].all():
        raise DockctlError(
            f"no start is free in '{loaded.scenario.name}': take other --headings or --reach-m"
        )
    plan = worlds[own_site(loaded.scenario).harbor].scene()
    caption = f"policy of {trained.card.scenario}, seed {trained.card.seed}"
    show(table, trained, loaded.scenario.name)
    with house_style():
        figure = map_figure(table, plan, loaded.scenario.task, caption)
        places.store(text, save({places.stem: figure}, places.figures))


def measure(
    trained: Trained, loaded: LoadedScenario, worlds: Sequence[World], grid: Grid
) -> list[dict[str, Value]]:
    """Play an episode from every free start of the grid around the first initial pose of the task.

    Returns:
        rows of the columns `dockctl.runs.tables.MAP`.
    """
    scenario = loaded.scenario
    site = own_site(scenario)
    check = pose_check(loaded)
    rows: list[dict[str, Value]] = []
    with Progress(console=Console(stderr=True), transient=True) as progress:
        for heading in progress.track(grid.headings_deg, description=f"starts in '{scenario.name}'"):
            offsets = grid.offsets(heading)
            poses = site.initial[0] + np.column_stack([offsets[:, :2], np.radians(offsets[:, 2])])
            free = [check.free(pose) for pose in poses]
            starts = [
                given_start(site, scenario.task, pose, number)
                for number, pose in enumerate(poses)
                if free[number]
            ]
            played = iter(player(loaded, worlds, starts)(trained.policy) if starts else [])
            rows += [
                _row(offset, pose, next(played) if is_free else None, scenario.vessel.control_period_s)
                for offset, pose, is_free in zip(offsets, poses, free, strict=True)
            ]
    return rows


def _row(offset: Floats, pose: Floats, episode: Episode | None, control_period_s: float) -> dict[str, Value]:
    """One start; where it is blocked there is no episode."""
    place: dict[str, Value] = {
        "dx_m": offset[0],
        "dy_m": offset[1],
        "dheading_deg": offset[2],
        "x_m": pose[0],
        "y_m": pose[1],
        "heading_deg": math.degrees(pose[2]),
        "blocked": episode is None,
    }
    return (
        place if episode is None else {**place, **episode.row(), "time_s": episode.steps * control_period_s}
    )


def show(table: pd.DataFrame, trained: Trained, scenario: str) -> None:
    """Print how the starts of every heading ended."""
    console, free, reach = Console(), free_starts(table), half_width(table)
    say(
        console,
        f"Policy {trained.file} on scenario '{scenario}': {len(free):,} free starts within"
        f" ±{reach:g} m, {len(table) - len(free):,} blocked",
    )
    summary = Table(header_style="bold", box=box.SIMPLE_HEAD)
    for name in (
        "turned\nby",
        "\ndocked",
        "",
        "95 %\ninterval",
        "\ncollision",
        "\ntimeout",
        "success\nradius",
    ):
        summary.add_column(name, justify="right", no_wrap=True)
    headings = table["dheading_deg"].unique()
    groups = [(f"{heading:+g}°", free[free["dheading_deg"] == heading]) for heading in headings]
    for name, group in [
        *groups,
        (f"up to {SMALL_OFFSET_DEG:g}°", within_heading(free, SMALL_OFFSET_DEG)),
        ("all", free),
    ]:
        if not len(group):
            summary.add_row(name, "no free start")
            continue
        docked = int(group["docked"].sum())
        low, high = wilson_interval(docked, len(group))
        endings = [f"{(group['outcome'] == outcome).sum()}" for outcome in ("collision", "timeout")]
        summary.add_row(
            name,
            f"{docked} of {len(group)}",
            f"{docked / len(group):.1%}",
            f"{low:.0%} to {high:.0%}",
            *endings,
            format_radius(success_radius(group, reach)),
        )
    console.print(summary)
    say(console, "Success radius: the largest distance up to which every free start docks.")
