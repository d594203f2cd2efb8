"""Success map: greedy episodes from a grid of start positions and headings around a pose."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dockctl.drawing.scene import Scene
from dockctl.errors import DockctlError
from dockctl.evaluation.evaluate import Run, running
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Rollout
from dockctl.evaluation.starts import pose_check
from dockctl.geometry import Floats
from dockctl.runs.tables import MAP, Value, all_columns, to_csv
from dockctl.scenarios.schema import Scenario
from dockctl.sim.checks import PoseCheck
from dockctl.sim.starts import Site, given_start, own_site

if TYPE_CHECKING:
    import pandas as pd

MAX_STARTS = 100_000
MAX_HEADING_DEG = 360.0


@dataclass(frozen=True)
class Grid:
    """Offsets of starts from a reference pose.

    Attributes:
        reach_m: half-width of the square of positions [m].
        step_m: distance between neighboring positions [m].
        headings_deg: heading offsets at each position [°].
    """

    reach_m: float = 10.0
    step_m: float = 2.0
    headings_deg: tuple[float, ...] = (0, 20, -20, 45, -45, 90, -90, 180)

    def __post_init__(self) -> None:
        angles = self.headings_deg
        if not (0 <= self.reach_m < math.inf and 0 < self.step_m < math.inf):
            size = f"reach {self.reach_m:g} m and step {self.step_m:g} m"
            message = f"{size}: expected finite, nonnegative numbers, and a step above 0"
            raise DockctlError(message, code="out_of_range")
        is_within = all(abs(angle) <= MAX_HEADING_DEG for angle in angles)
        if not angles or not is_within or len({angle % 360 for angle in angles}) < len(angles):
            message = f"must be one or more different directions, within ±{MAX_HEADING_DEG:g}°"
            raise DockctlError(f"heading offsets {angles}: {message}", code="out_of_range")
        side = 2 * self._steps + 1
        if (count := len(angles) * side * side) > MAX_STARTS:
            raise DockctlError(
                f"the map would have {count:,.0f} starts, more than {MAX_STARTS:,}: choose a larger step",
                code="out_of_range",
            )

    @property
    def positions_m(self) -> Floats:
        """Offsets along one axis, (k,) [m], zero in the middle."""
        return self.step_m * np.arange(-self._steps, self._steps + 1)

    @property
    def _steps(self) -> float:
        """Positions from the middle to the edge; infinite where the quotient is too large for a number."""
        return float(np.floor(self.reach_m / self.step_m + 1e-9))

    def offsets(self, heading_deg: float) -> Floats:
        """Return dx [m], dy [m] and heading offset [°] of all starts with one heading offset, (k², 3)."""
        dx, dy = np.meshgrid(self.positions_m, self.positions_m, indexing="ij")
        return np.column_stack([dx.ravel(), dy.ravel(), np.full(dx.size, heading_deg)])


@dataclass(frozen=True, eq=False)
class SuccessMap:
    """Outcomes of the starts of a grid.

    Attributes:
        csv: text of ``map.csv``.
        table: its content, columns `dockctl.runs.tables.MAP`.
        plan: plan view of the harbor, for the figure.
    """

    policy: LoadedPolicy
    scenario: Scenario
    overrides: tuple[str, ...]
    csv: str
    plan: Scene

    @property
    def table(self) -> pd.DataFrame:
        import pandas as pd  # slow to import

        return pd.read_csv(io.StringIO(self.csv), keep_default_na=False, na_values=[""])

    def as_json(self) -> dict[str, Any]:
        """Return the starts and the outcomes of their episodes, as plain data."""
        return {
            "policy": self.policy.facts(),
            "scenario": self.scenario.name,
            "set": list(self.overrides),
            "starts": self.table.to_dict("records"),
        }


def success_map(
    policy: str | Path | LoadedPolicy | None = None,
    scenario: str | Path | None = None,
    grid: Grid | None = None,
    *,
    overrides: Sequence[str] = (),
    on: str | None = None,
) -> SuccessMap:
    """Run a policy from every free start of a grid around the first initial pose of the task.

    Args:
        policy: see `dockctl.evaluation.loading.load_policy`; the latest run by default.
        scenario: file or name; the policy's own by default.
        grid: ±10 m in steps of 2 m with eight headings by default.
        overrides: changed values of the scenario, ``key=value``.
        on: run the episodes on Ray, see `dockctl.cluster.connected`; the result is the same.

    Raises:
        DockctlError: there is no such policy or scenario, they do not match, no start is free, or Ray cannot
            be used.
    """
    loaded_policy, grid = load_policy(policy), grid or Grid()
    loaded = loaded_policy.scenario(scenario, overrides)
    rollout = Rollout(loaded)
    site, check = own_site(loaded.scenario), pose_check(loaded)
    with running(on) as prepared:
        run = prepared(loaded_policy, rollout)
        # One heading at a time: the trajectories of all starts would take memory.
        rows = [
            row
            for number, heading in enumerate(grid.headings_deg)
            for row in _rows(loaded.scenario, site, check, run, grid.offsets(heading), number)
        ]
    if all(row["blocked"] for row in rows):
        raise DockctlError(
            f"no start is free in '{loaded.scenario.name}': choose other headings or a larger reach"
        )
    plan = rollout.worlds[site.harbor].scene()
    csv = to_csv(rows, all_columns(MAP, rows))
    return SuccessMap(loaded_policy, loaded.scenario, tuple(overrides), csv, plan)


def _rows(
    scenario: Scenario, site: Site, check: PoseCheck, run: Run, offsets: Floats, number: int
) -> Iterator[dict[str, Value]]:
    """Yield the rows of the starts with one heading offset; a blocked start has no episode.

    Each start of the map has conditions of its own, which do not depend on the policy.

    Args:
        offsets: (k, 3) dx [m], dy [m] and heading offset [°].
        number: of these starts' heading offset, from 0.
    """
    poses = site.initial[0] + np.column_stack([offsets[:, :2], np.radians(offsets[:, 2])])
    free = [check.free(pose) for pose in poses]
    first_seed = scenario.evaluation.conditions_seed + number * len(poses)
    starts = [
        replace(given_start(site, scenario.evaluated_task, poses[i], i), seed=first_seed + i)
        for i in np.flatnonzero(free).tolist()
    ]
    episodes = iter(run(starts))
    for (dx, dy, turn), (x, y, heading), is_free in zip(offsets, poses, free, strict=True):
        place: dict[str, Value] = {
            "dx_m": dx, "dy_m": dy, "dheading_deg": turn,
            "x_m": x, "y_m": y, "heading_deg": math.degrees(heading), "blocked": not is_free,
        }  # fmt: skip
        if is_free:
            episode = next(episodes)
            time_s = episode.steps * scenario.vessel.control_period_s
            place |= {**episode.row(), **episode.maneuver(), "time_s": time_s}
        yield place
