"""Evaluate a policy: greedy episodes from the evaluation poses and from random starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dockctl.analysis.episodes import summarize
from dockctl.control.planner import has_planner
from dockctl.control.supervisor import has_supervisor
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import CheckpointPolicy, LoadedPolicy
from dockctl.evaluation.record import Recording
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.evaluation.starts import checked_starts, evaluation_starts, testing_starts, trajectory_starts
from dockctl.run_files import EVALUATION
from dockctl.runs.results import result_stem
from dockctl.runs.tables import EVALUATION as EVALUATION_COLUMNS
from dockctl.runs.tables import START_KEYS, Value, all_columns, to_csv
from dockctl.scenarios.base import Pose
from dockctl.scenarios.schema import Scenario
from dockctl.sim.starts import Start, own_site

if TYPE_CHECKING:
    import pandas as pd

Run = Callable[[Sequence[Start]], list[Episode]]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The episodes of one policy in one scenario.

    Attributes:
        overrides: changed values of the scenario, ``key=value``.
        seed: of the random starts.
        rejected_draws: number of unreachable poses that were drawn for the random starts and redrawn.
        groups: episodes by kind of start, keys of `START_KEYS`.
        recording: if requested, the episodes from the poses, or at each berth of a task with berths.
    """

    policy: LoadedPolicy
    scenario: Scenario
    overrides: tuple[str, ...]
    seed: int
    rejected_draws: int
    groups: dict[str, list[Episode]]
    recording: Recording | None = None

    @property
    def control_period_s(self) -> float:
        return self.scenario.vessel.control_period_s

    @property
    def supervised(self) -> bool:
        """Whether a `Supervisor` ran the policy."""
        policy = self.policy.policy if isinstance(self.policy, CheckpointPolicy) else None
        return has_supervisor(policy, self.scenario)

    @property
    def planned(self) -> bool:
        """Whether a `Planner` ran the policy."""
        return has_planner(self.scenario)

    @cached_property
    def is_own(self) -> bool:
        """Whether the scenario is the policy's own, unchanged."""
        return self.policy.is_own(self.scenario, self.overrides)

    @property
    def notes(self) -> list[str]:
        """See `LoadedPolicy.notes_on`."""
        return self.policy.notes_on(self.scenario, self.overrides)

    @property
    def stem(self) -> str:
        """Common stem of the result files' names."""
        return result_stem(EVALUATION, "" if self.is_own else self.scenario.name, self.overrides)

    @property
    def lowest_success(self) -> float:
        """Lowest success rate among the kinds of start."""
        return min(sum(e.docked for e in group) / len(group) for group in self.groups.values())

    @cached_property
    def summaries(self) -> dict[str, dict[str, Any]]:
        """Success rate with interval, outcomes and means, by kind of start."""
        return {
            kind: summarize(
                [{**episode.row(), **episode.maneuver()} for episode in group], self.control_period_s
            )
            for kind, group in self.groups.items()
        }

    @property
    def table(self) -> pd.DataFrame:
        """One row per episode, columns `dockctl.runs.tables.EVALUATION`."""
        import pandas as pd  # slow to import

        return pd.DataFrame(self.rows())

    def csv(self) -> str:
        """Return `table` as CSV text."""
        rows = self.rows()
        return to_csv(rows, all_columns(EVALUATION_COLUMNS, rows))

    def rows(self) -> list[dict[str, Value]]:
        """Return the rows of `table`."""
        return [
            {
                "start_kind": kind,
                "start": number,
                "berth": episode.start.berth,
                "x_m": episode.start.eta[0],
                "y_m": episode.start.eta[1],
                "heading_deg": math.degrees(episode.start.eta[2]),
                **episode.row(),
                **episode.maneuver(),
                "time_s": episode.steps * self.control_period_s,
            }
            for kind, episodes in self.groups.items()
            for number, episode in enumerate(episodes)
        ]

    def as_json(self) -> dict[str, Any]:
        """Return the content of ``evaluation.json``."""
        return {
            "policy": self.policy.facts(),
            "scenario": self.scenario.name,
            "set": list(self.overrides),
            "supervised": self.supervised,
            "planned": self.planned,
            "random_seed": self.seed,
            "rejected_draws": self.rejected_draws,
            **{START_KEYS[kind]: summary for kind, summary in self.summaries.items()},
            "episodes": self.rows(),
        }


@contextmanager
def running(on: str | None) -> Iterator[Callable[[LoadedPolicy, Rollout], Run]]:
    """Yield a function that prepares a policy to run from any starts, in this process or on Ray.

    It raises `DockctlError` if the policy does not match the environment.

    Args:
        on: see `dockctl.cluster.connected`; None for this process.

    Raises:
        DockctlError: Ray cannot be used.
    """
    if on is None:
        yield lambda policy, rollout: partial(rollout.run, policy.make(rollout.env()))
        return
    from dockctl.cluster import connected

    with connected(on) as cores:
        from dockctl.evaluation.ray_rollout import RayRollout

        def prepared(policy: LoadedPolicy, rollout: Rollout) -> Run:
            policy.make(rollout.env())  # errors of workers would name files of theirs
            return RayRollout(rollout, policy, cores).run

        yield prepared


def evaluate(
    policy: str | Path | LoadedPolicy | None = None,
    scenario: str | Path | None = None,
    *,
    episodes: int | None = None,
    seed: int | None = None,
    overrides: Sequence[str] = (),
    poses: Sequence[Pose] = (),
    record: bool = False,
    on: str | None = None,
) -> Evaluation:
    """Run a policy from a scenario's evaluation poses and from random starts.

    Args:
        policy: see `dockctl.evaluation.loading.load_policy`; the latest run by default.
        scenario: file or name; the policy's own by default.
        episodes: number of random starts; by default the scenario's, and none with `poses`.
        seed: of the random starts; the scenario's by default.
        overrides: changed values of the scenario, ``key=value``.
        poses: to start from instead of the evaluation poses.
        record: also return the trajectories.
        on: run the episodes on Ray, see `dockctl.cluster.connected`; the result is the same.

    Raises:
        DockctlError: there is no such policy or scenario, they do not match, a pose is not free, or Ray
            cannot be used.
    """
    loaded_policy = load_policy(policy)
    loaded = loaded_policy.scenario(scenario, overrides)
    resolved = loaded.scenario
    random = resolved.evaluation.random_starts
    seed = random.seed if seed is None else seed
    if episodes is None:
        episodes = 0 if poses else random.episodes
    rollout = Rollout(loaded)
    starts = checked_starts(loaded, poses) if poses else evaluation_starts(resolved, rollout.worlds, seed)
    starts += testing_starts(resolved, rollout.worlds, episodes, seed)
    shown: list[Episode] = []
    with running(on) as prepared:
        run = prepared(loaded_policy, rollout)
        results = run(starts)
        groups: dict[str, list[Episode]] = {start.kind: [] for start in starts}
        for episode in results:
            groups[episode.start.kind].append(episode)
        if record:
            shown = groups.get("pose") or run(trajectory_starts(resolved, rollout.worlds))
    recording = None
    if record:
        if poses:
            tests = resolved.evaluation.model_copy(update={"poses": tuple(poses)})
            resolved = resolved.model_copy(update={"evaluation": tests})
        scene = rollout.worlds[own_site(resolved).harbor].scene()
        recording = Recording(loaded_policy, resolved, scene, shown)
    return Evaluation(
        policy=loaded_policy,
        scenario=loaded.scenario,
        overrides=tuple(overrides),
        seed=seed,
        rejected_draws=sum(start.rejected for start in starts),
        groups=groups,
        recording=recording,
    )
