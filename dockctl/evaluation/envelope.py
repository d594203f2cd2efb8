"""The operating envelope: how often a policy docks as one factor grows (``dockctl envelope``).

Everything else is as in the scenario.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dockctl.errors import DockctlError, nearest
from dockctl.evaluation.evaluate import running
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.rollout import Rollout
from dockctl.evaluation.starts import testing_starts
from dockctl.runs.tables import OUTCOMES, Value
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import Start
from dockctl.sim.world import build_worlds

if TYPE_CHECKING:
    import pandas as pd

ANY_DIRECTION = "direction_deg: [0, 360]"


@dataclass(frozen=True)
class Factor:
    """A factor that is varied.

    Attributes:
        label: description of the values, with their unit.
        values: in increasing order.
        settings: returns the overrides of a scenario, ``key=value``, for a value.
    """

    label: str
    values: tuple[float, ...]
    settings: Callable[[Scenario, float], list[str]]


def _only(scenario: Scenario, kind: str, values: str) -> list[str]:
    """Return overrides that change the scenario's condition of this kind, or add one, and remove others."""
    given = [name for name, each in scenario.conditions.items() if each.kind == kind]
    if not given and kind in scenario.conditions:  # the name of another kind
        return [f"conditions.varied_{kind}={{kind: {kind}, {values}}}"]
    name, *others = given or [kind]
    return [f"conditions.{name}={{{values}}}", *(f"conditions.{other}=null" for other in others)]


def _noise(scenario: Scenario, times: float) -> list[str]:
    """Return overrides for multiples of the errors of real sensors (Navigation in docs/conditions.md)."""
    navigation = f"position_m: {0.02 * times}, heading_deg: {0.5 * times}, velocity_mps: {0.03 * times}"
    noise = _only(scenario, "lidar_noise", f"sigma_m: {0.03 * times}")
    return noise + _only(scenario, "navigation", navigation)


FACTORS = {
    "distance": Factor(
        "largest offset of the start from the initial pose, in x and in y [m]",
        (0, 1, 2, 3, 5, 7.5, 10),
        lambda _, value: [f"evaluation.random_starts.position_m={value}"],
    ),
    "heading": Factor(
        "largest heading offset of the start [°]",
        (0, 10, 20, 45, 90, 180),
        lambda _, value: [f"evaluation.random_starts.heading_deg={value}"],
    ),
    "wind": Factor(
        "mean wind from any direction [m/s]",
        (0, 2, 4, 6, 8, 10),
        lambda scenario, value: _only(scenario, "wind", f"speed_mps: {value}, {ANY_DIRECTION}"),
    ),
    "current": Factor(
        "current in any direction [m/s]",
        (0, 0.05, 0.1, 0.15, 0.2, 0.3),
        lambda scenario, value: _only(scenario, "current", f"speed_mps: {value}, {ANY_DIRECTION}"),
    ),
    "noise": Factor("noise of LiDAR and navigation, relative to data sheets", (0, 1, 2, 4), _noise),
    "delay": Factor(
        "delay of the actuators [control steps]",
        (0, 1, 2, 3),
        lambda scenario, value: _only(scenario, "actuators", f"delay_steps: {value:g}"),
    ),
}


@dataclass(frozen=True, eq=False)
class Envelope:
    """Outcomes by factor and value.

    Attributes:
        rows: columns `dockctl.runs.tables.ENVELOPE`.
    """

    policy: LoadedPolicy
    scenario: Scenario
    overrides: tuple[str, ...]
    rows: list[dict[str, Value]]

    @property
    def table(self) -> pd.DataFrame:
        import pandas as pd  # slow to import

        return pd.DataFrame(self.rows)

    def as_json(self) -> dict[str, Any]:
        """Return the outcomes as plain data."""
        return {
            "policy": self.policy.facts(),
            "scenario": self.scenario.name,
            "set": list(self.overrides),
            "points": self.rows,
        }


def envelope(
    policy: str | Path | LoadedPolicy | None = None,
    scenario: str | Path | None = None,
    *,
    factors: Sequence[str] = tuple(FACTORS),
    episodes: int = 100,
    overrides: Sequence[str] = (),
    on: str | None = None,
) -> Envelope:
    """Run a policy from random starts while one factor grows at a time.

    The starts for all values use the same random numbers, so that the levels of wind, current, noise or delay
    are compared from the same starts.

    Args:
        policy: see `dockctl.evaluation.loading.load_policy`; the latest run by default.
        scenario: file or name; the policy's own by default.
        factors: names in `FACTORS`.
        episodes: random starts for each value, at the held-out berths if the task has any.
        overrides: changed values of the scenario, ``key=value``.
        on: run the episodes on Ray, see `dockctl.cluster.connected`; the result is the same.

    Raises:
        DockctlError: there is no such policy, scenario or factor, they do not match, or Ray cannot be used.
    """
    for name in factors:
        if name not in FACTORS:
            message = f"unknown factor '{name}' (known: {', '.join(FACTORS)})"
            raise DockctlError(message, code="unknown_name", suggestion=nearest(name, FACTORS))
    if repeated := [name for name, count in Counter(factors).items() if count > 1]:
        raise DockctlError(f"the factor '{repeated[0]}' is given twice", code="duplicate")
    loaded = load_policy(policy)
    own = loaded.scenario(scenario, overrides)
    worlds = build_worlds(own.scenario, own.base_dir)  # no factor changes a harbor
    rows = list[dict[str, Value]]()
    with running(on) as prepared:
        for name in factors:
            for value in FACTORS[name].values:
                changes = FACTORS[name].settings(own.scenario, value)
                rollout = Rollout(loaded.scenario(scenario, [*overrides, *changes]), worlds)
                run = prepared(loaded, rollout)
                outcomes = Counter(episode.outcome for episode in run(_starts(rollout, episodes)))
                counts = {outcome: outcomes[outcome] for outcome in OUTCOMES}
                rows.append({"factor": name, "value": value, "episodes": episodes, **counts})
    return Envelope(loaded, own.scenario, tuple(overrides), rows)


def _starts(rollout: Rollout, episodes: int) -> list[Start]:
    seed = rollout.scenario.evaluation.random_starts.seed
    return testing_starts(rollout.scenario, rollout.worlds, episodes, seed)
