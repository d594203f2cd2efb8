"""Episodes with everything that the 3-D replay shows: harbor, trajectory, LiDAR points and Q-values."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dockctl.agents.interface import Policy, QPolicy
from dockctl.analysis.episodes import describe_outcome
from dockctl.compute import workers
from dockctl.drawing import palette
from dockctl.drawing.scene import Scene, water
from dockctl.evaluation.loading import load_policy
from dockctl.evaluation.policies import LoadedPolicy, distinct_names
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.evaluation.starts import checked_starts, layout_harbor, trajectory_starts
from dockctl.geometry import Floats, pose_label, sector_edges_deg
from dockctl.scenarios.base import Pose
from dockctl.scenarios.extensions import RangeSensor
from dockctl.scenarios.loader import LoadedScenario
from dockctl.scenarios.schema import Scenario, Task
from dockctl.sim.harbor.build import Harbor, build_scene
from dockctl.sim.harbor.solids import hull_mesh, hull_outline
from dockctl.sim.starts import Start
from dockctl.sim.world import scan_points

MAX_SCANS, MAX_POINTS = 240, 360_000
"""Maximum number of LiDAR scans and approximate number of points in all episodes, to limit page size."""
SPARSE = 16
"""Only every n-th ray, with this n, is traced to estimate the number of returns of a scan."""
FARTHEST_M = 327.0
"""Maximum coordinate of the points in the page, which are 16-bit centimeters."""
MAX_TRIANGLES = 200_000
"""Maximum number of triangles of a harbor in the page; in larger harbors the smallest are omitted."""
REWARD = "reward_"
FLOWS = ("current", "wind")
"""Velocities (n, 2) in the world frame [m/s], drawn as arrows."""
FLOATS = ("pose", "velocity", "command", "distance_m", "heading_error_rad", "reward")


@dataclass(frozen=True, eq=False)
class Track:
    """One episode of a policy.

    Attributes:
        policy, caption: name and description of the policy; empty for a boat at its start.
        scans: points (k, 3) [m] in the body frame, by the step at which they were measured.
        q_values: (steps + 1, actions), for policies that have them.
        scenario: the one that the policy ran in; that of the replay, with the policy's own interface.
    """

    scenario: Scenario
    policy: str
    caption: str
    start: Start
    episode: Episode
    scans: dict[int, Floats]
    q_values: NDArray[np.float32] | None


@dataclass(frozen=True, eq=False)
class Replay:
    """Episodes in one harbor."""

    scenario: Scenario
    harbor: Harbor
    tracks: list[Track]

    @property
    def scene(self) -> Scene:
        """The harbor and the boat from above."""
        return build_scene(self.harbor, self.scenario.vessel.hull)


def replay(
    policies: Sequence[str | Path | LoadedPolicy],
    scenario: str | Path | None = None,
    poses: Sequence[Pose] = (),
    overrides: Sequence[str] = (),
) -> Replay:
    """Run each policy from each pose; by default from the trajectory starts of the scenario.

    Args:
        policies: one or more; see `dockctl.evaluation.loading.load_policy`.
        scenario: file or name; by default the scenario of the first policy.
        overrides: changed values of the scenario, ``key=value``.

    Raises:
        DockctlError: there is no such policy or scenario, they do not match, or a pose is not free.
    """
    given = [load_policy(policy) for policy in policies]
    first = given[0]
    loaded = first.scenario(scenario, overrides)
    starts, runs = _starts(loaded, poses), []
    for name, policy in zip(distinct_names(given), given, strict=True):
        is_first = policy is first
        rollout = Rollout(loaded if is_first else policy.scenario(scenario or first.own_scenario, overrides))
        made = policy.make(rollout.env())
        played = zip(starts, rollout.run(made, starts), strict=True)
        runs += [_Run(name, policy.caption, made, start, episode, rollout) for start, episode in played]
    return _replay(loaded, runs)


def preview(loaded: LoadedScenario, poses: Sequence[Pose] = ()) -> Replay:
    """Return the boat at each start, without a policy; the arguments are those of `replay`."""
    rollout = Rollout(loaded)
    starts = rollout.seeded(_starts(loaded, poses))
    return _replay(loaded, [_Run("", "", None, start, rollout.at_start(start), rollout) for start in starts])


class _Run(NamedTuple):
    name: str
    caption: str
    policy: Policy | None
    start: Start
    episode: Episode
    rollout: Rollout


def _starts(loaded: LoadedScenario, poses: Sequence[Pose]) -> list[Start]:
    """Return the starts, all in the harbor of the first one.

    Raises:
        DockctlError: a pose is not free.
    """
    if poses:
        return checked_starts(loaded, poses)
    starts = trajectory_starts(loaded.scenario, Rollout(loaded).worlds)
    return [start for start in starts if start.harbor == starts[0].harbor]


def _replay(loaded: LoadedScenario, runs: Sequence[_Run]) -> Replay:
    scenario, tracks = loaded.scenario, []
    rows = sum(run.episode.steps + 1 for run in runs)
    stride = -(-rows // MAX_SCANS)
    for run in runs:
        measured = range(0, run.episode.steps + 1, stride)
        lidar = run.rollout.worlds[run.start.harbor].lidar
        own = run.rollout.scenario
        cloud = partial(_cloud, lidar, own.sensors.lidar.kind, MAX_POINTS * stride // rows)
        clouds = workers().map(cloud, run.episode.trajectory["pose"][measured])
        scans = dict(zip(measured, clouds, strict=True))
        tracks.append(
            Track(
                own, run.name, run.caption, run.start, run.episode, scans, _q_values(run.policy, run.episode)
            )
        )
    return Replay(scenario, layout_harbor(loaded, runs[0].start.harbor), tracks)


def _cloud(lidar: RangeSensor, kind: str, count: int, pose: Floats) -> Floats:
    """Return about `count` points (k, 3) [m] of a scan from one pose (3,), from evenly spaced rays."""
    returns = SPARSE * len(scan_points(lidar, kind, pose, SPARSE))
    points = scan_points(lidar, kind, pose, max(1, -(-returns // max(count, 1))))
    return points[(np.abs(points) < FARTHEST_M).all(axis=1)]


def _q_values(policy: Policy | None, episode: Episode) -> NDArray[np.float32] | None:
    return policy.q_values(episode.trajectory["observation"]) if isinstance(policy, QPolicy) else None


def page_data(replay: Replay) -> dict[str, Any]:
    """Return what `dockctl.reports.replay.page` shows, as plain data and arrays."""
    scenario, titles = replay.scenario, _titles(replay)
    captions = dict.fromkeys(track.caption for track in replay.tracks)
    names = list(dict.fromkeys(track.policy for track in replay.tracks))
    numbers = [names.index(track.policy) if len(names) > 1 else i for i, track in enumerate(replay.tracks)]
    colors = palette.SERIES if len(replay.tracks) > 1 else (palette.OWN_HULL,)
    return {
        "title": f"Scenario {scenario.name}, harbor {replay.harbor.name}",
        "subtitle": ", ".join(filter(None, captions)) or "the boat at its start",
        "bounds": list(water(replay.scene)),
        "harbor": _harbor(replay.harbor),
        "boat": _boat(scenario),
        "limits": {name: getattr(scenario.vessel, f"max_{name}") for name in ("propeller_n", "rudder_deg")},
        "period_s": scenario.vessel.control_period_s,
        "terms": _terms(replay.tracks[0]),
        "episodes": [
            _episode(scenario.task, track, label, colors[number % len(colors)])
            for number, track, label in zip(numbers, replay.tracks, titles, strict=True)
        ],
    }


def _harbor(harbor: Harbor) -> dict[str, Any]:
    """Triangles and their colors; corners as 16-bit integers, at a resolution of a few millimeters."""
    solids = [(part.name, solid) for part in harbor.parts for solid in part.solids]
    colors = [palette.solid_colors(solid.kind, name)[0] for name, solid in solids]
    shades = list(dict.fromkeys(colors))
    corners = [np.asarray(solid.mesh.triangles, float) for _, solid in solids]
    triangles = np.concatenate(corners) if corners else np.zeros((0, 3, 3))
    color = np.repeat([shades.index(name) for name in colors], [len(part) for part in corners])
    if len(triangles) > MAX_TRIANGLES:
        area = np.linalg.norm(
            np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1
        )
        largest = np.sort(np.argsort(area)[-MAX_TRIANGLES:])
        triangles, color = triangles[largest], color[largest]
    low, high = (
        (triangles.min((0, 1)), triangles.max((0, 1))) if len(triangles) else (np.zeros(3), np.ones(3))
    )
    scale = float((high - low).max()) / 65_000
    origin = (low + high) / 2
    return {
        "corners": np.round((triangles.reshape(-1, 9) - np.tile(origin, 3)) / scale).astype("<i2"),
        "color": color[:, None].astype("u1"),
        "palette": shades,
        "scale": scale,
        "origin": origin.tolist(),
    }


def _boat(scenario: Scenario) -> dict[str, Any]:
    hull = scenario.vessel.hull
    return {
        "corners": np.asarray(hull_mesh(hull).triangles, "<f4").reshape(-1, 3),
        "outline": np.round(hull_outline(hull), 3).tolist(),
        "length": hull.length_m,
        "stern": -hull.length_m / 2,
        "freeboard": hull.freeboard_m,
        "lidars": scenario.sensors.lidar.origins,
    }


def _terms(track: Track) -> list[str]:
    names = (key.removeprefix(REWARD) for key in track.episode.trajectory if key.startswith(REWARD))
    return [name for name in names if not name.startswith("_")]


def _titles(replay: Replay) -> list[str]:
    """Return a label for each track that distinguishes it from the others."""
    policies = len({track.policy for track in replay.tracks}) > 1
    starts = len({tuple(track.start.eta) for track in replay.tracks}) > 1
    titles = []
    for track in replay.tracks:
        x, y, heading = track.start.eta
        pose = pose_label(x, y, math.degrees(heading))
        titles.append(" ".join([track.policy] * policies + [pose] * (starts or not policies)))
    return titles


def _episode(task: Task, track: Track, label: str, color: str) -> dict[str, Any]:
    episode, recorded = track.episode, track.episode.trajectory
    terms = np.stack([recorded[REWARD + name] for name in _terms(track)], axis=1)
    arrays = {
        **{name: recorded[name].astype("<f4") for name in FLOATS},
        "ranges": recorded["sector_ranges_m"].astype("<f4"),
        "phase": recorded["phase"].astype("u1"),
        "returns": recorded["reward"].cumsum().astype("<f4"),
        "terms": terms.astype("<f4"),
        "term_sums": terms.cumsum(axis=0).astype("<f4"),
        "points": np.round(100 * np.concatenate(list(track.scans.values()))).astype("<i2"),
        "scans": np.column_stack([list(track.scans), _firsts(track)]).astype("<i4"),
    }
    flows = [name for name in FLOWS if name in recorded]
    arrays |= {name: recorded[name].astype("<f4") for name in flows}
    if track.q_values is not None:
        arrays["q"] = track.q_values.astype("<f4")
    tolerances = task.intermediate_tolerance, task.final_tolerance
    goals = [
        [*pose, tolerance.distance_m, tolerance.heading]
        for pose, tolerance in list(zip(track.start.goals.tolist(), tolerances, strict=True))[
            track.start.phase :
        ]
    ]
    row = episode.row()
    text = describe_outcome(row) if episode.outcome else "at the start"
    return {
        "policy": track.policy or "none",
        "label": label,
        "color": color,
        "grid": track.scenario.actions.grid,
        "range_m": track.scenario.sensors.lidar.range_m,
        "outcome": episode.outcome,
        "text": text,
        "goals": goals,
        "flow": flows,
        "sector_edges": np.radians(sector_edges_deg(arrays["ranges"].shape[1])).tolist(),
        "arrays": arrays,
    }


def _firsts(track: Track) -> list[int]:
    """Return the index of the first point of each scan."""
    counts = [len(points) for points in track.scans.values()]
    return [0, *np.cumsum(counts)[:-1].tolist()]
