"""What we see in a figure, in a few numbers: over the seeds of a training, or over recorded maneuvers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dockctl.analysis.learning import RECENT, from_initial_poses
from dockctl.analysis.trajectories import Track
from dockctl.scenarios.schema import Task
from studies.thesis.kept import Kept
from studies.thesis.markdown import listed, spread

TOP_SHARE = 0.9
"""A boat runs at top speed while it makes at least this share of it."""


def slowing_m(track: Track) -> float:
    """Distance to the last goal at which the boat makes top speed for the last time [m]."""
    rows = track.table
    if (switch := track.switch) is not None:
        rows = rows.iloc[switch:]
    speed = np.hypot(rows["u_mps"].to_numpy(float), rows["v_mps"].to_numpy(float))
    fast = np.flatnonzero(speed >= TOP_SHARE * speed.max())
    return float(rows["distance_m"].iloc[int(fast[-1])])


def ending(track: Track) -> str:
    """How a track ends, in a word or two."""
    outcome = str(track.table["outcome"].iloc[-1])
    return "out of time" if outcome == "timeout" else outcome


def change_share(track: Track, column: str) -> float:
    """Share of the control steps in which a command changes."""
    values = track.table[column].to_numpy()[1:]  # the first row is the state before the first command
    return float((np.diff(values) != 0).mean()) if len(values) > 1 else 0.0


def change_size(track: Track, column: str) -> float:
    """Mean size of the change of a command from one control step to the next."""
    values = track.table[column].to_numpy()[1:]
    return float(np.abs(np.diff(values)).mean()) if len(values) > 1 else 0.0


def reward(runs: Sequence[Kept]) -> str:
    first = [run.first_docked for run in runs if run.first_docked is not None]
    streaks = [run.best_streak() for run in runs]
    return (
        f"greedy docks first after {spread(first, '{:,.0f}', ' steps')}; longest streak of docked episodes"
        f" from an initial pose {spread(streaks, '{:,.0f}')}"
    )


def duration(runs: Sequence[Kept]) -> str:
    rows = [from_initial_poses(run.episodes)["steps"] for run in runs]
    limits = [run.run.task.max_steps for run in runs]
    full = [_first(steps.to_numpy(int) < limit) for steps, limit in zip(rows, limits, strict=True)]
    last = [float(steps.tail(RECENT).mean()) for steps in rows]
    return (
        f"{_spread_of_firsts(full)} episodes until the first ends early; the last {RECENT} take"
        f" {spread(last, '{:.0f}', ' steps')}; over after"
        f" {spread([len(run.episodes) for run in runs], '{:,}')} episodes"
    )


def epsilon(runs: Sequence[Kept]) -> str:
    last = [float(run.episodes["epsilon"].iloc[-1]) for run in runs]
    return f"{spread(last, '{:.2g}')} when the training is over"


def phase(runs: Sequence[Kept]) -> str:
    firsts = []
    for run in runs:
        rows = from_initial_poses(run.episodes)
        at = _first(rows["phase"].rolling(RECENT).mean().to_numpy(float) >= 0.5)
        firsts.append(None if at is None else int(rows["episode"].iloc[at]))
    found = _spread_of_firsts(firsts)
    return f"half of {RECENT} episodes get past the intermediate pose from episode {found} on"


def pose(tracks: Sequence[Track], task: Task) -> str:
    done = sum(track.docked for track in tracks)
    if not done:
        return f"{done} of {len(tracks)} dock"
    paths = [_path_m(track) for track in tracks if track.docked]
    return f"{done} of {len(tracks)} dock, over {spread(paths, unit=' m')}"


def distance(tracks: Sequence[Track], task: Task) -> str:
    ends = [float(track.table["distance_m"].iloc[-1]) for track in tracks]
    return f"{spread(ends, '{:.2f}', ' m')} left after {spread(_seconds(tracks), '{:.0f}', ' s')}"


def gate(tracks: Sequence[Track], task: Task) -> str:
    switches = [
        float(track.table["time_s"].iloc[row]) for track in tracks if (row := track.switch) is not None
    ]
    missed = len(tracks) - len(switches)
    reached = f"intermediate pose at second {spread(switches, '{:.0f}')}" if switches else ""
    return listed(
        filter(
            None,
            [reached, f"{missed} of {len(tracks)} never there" if missed else "", distance(tracks, task)],
        )
    )


def heading(tracks: Sequence[Track], task: Task) -> str:
    ends = [abs(float(track.table["heading_error_deg"].iloc[-1])) for track in tracks]
    return f"{spread(ends, unit='°')} off at the end"


def turn(tracks: Sequence[Track], task: Task) -> str:
    """How long before the intermediate pose the heading is there and stays, and the heading at the end."""
    width = np.degrees(task.intermediate_tolerance.heading)
    ahead = []
    for track in tracks:
        if (switch := track.switch) is not None:
            way = track.table.iloc[:switch]
            off = np.flatnonzero(way["heading_error_deg"].abs().to_numpy(float) > width)
            settled = int(off[-1]) + 1 if len(off) else 0
            ahead.append(float(track.table["time_s"].iloc[switch] - track.table["time_s"].iloc[settled]))
    return (
        f"within {width:.0f}° for the last {spread(ahead, '{:.1f}', ' s')} before the intermediate pose;"
        f" {heading(tracks, task)}"
    )


def velocity(tracks: Sequence[Track], task: Task) -> str:
    top = [float(np.hypot(track.table["u_mps"], track.table["v_mps"]).max()) for track in tracks]
    return (
        f"{spread(top, '{:.2f}', ' m/s')} at most; last at top speed"
        f" {spread([slowing_m(track) for track in tracks], unit=' m')} off"
    )


def stop(tracks: Sequence[Track], task: Task) -> str:
    """Top speed, and how many end with the propeller ahead, which stops a boat that comes astern."""
    away = [off for track in tracks if (off := _ahead_from_m(track)) is not None]
    ahead = f", from {spread(away, unit=' m')} off" if away else ""
    return f"{velocity(tracks, task)}; {len(away)} of {len(tracks)} end with the propeller ahead{ahead}"


def yaw(tracks: Sequence[Track], task: Task) -> str:
    return f"{spread([float(track.table['r_degps'].abs().max()) for track in tracks], unit='°/s')} at most"


def propeller(tracks: Sequence[Track], task: Task) -> str:
    return _changes(tracks, "propeller_n", " N")


def rudder(tracks: Sequence[Track], task: Task) -> str:
    return _changes(tracks, "rudder_deg", "°")


OF_TRAININGS: dict[str, Callable[[Sequence[Kept]], str]] = {
    "reward": reward,
    "duration": duration,
    "epsilon": epsilon,
    "phase": phase,
}
OF_COURSES: dict[str, Callable[[Sequence[Track], Task], str]] = {
    "pose": pose,
    "distance": distance,
    "gate": gate,
    "heading": heading,
    "turn": turn,
    "velocity": velocity,
    "stop": stop,
    "yaw": yaw,
    "propeller": propeller,
    "rudder": rudder,
}
"""What is measured for each figure, by the key of a `studies.thesis.thesis.Fact`."""


def _first(true: np.ndarray) -> int | None:
    """Number of the first that is true."""
    return int(true.argmax()) if true.any() else None


def _spread_of_firsts(firsts: Sequence[int | None]) -> str:
    """From the smallest to the largest, and how many seeds never."""
    found = [first for first in firsts if first is not None]
    never = len(firsts) - len(found)
    return listed(
        filter(None, [spread(found, "{:,}") if found else "", f"never ({never} seeds)" if never else ""])
    )


def _ahead_from_m(track: Track) -> float | None:
    """Distance to the goal at which a boat that ends with the propeller ahead set it so for good [m]."""
    astern = np.flatnonzero(track.table["propeller_n"].to_numpy(float)[1:] <= 0)
    if not len(astern) or astern[-1] == len(track.table) - 2:
        return None
    return float(track.table["distance_m"].iloc[int(astern[-1]) + 1])


def _changes(tracks: Sequence[Track], column: str, unit: str) -> str:
    shares = [100 * change_share(track, column) for track in tracks]
    sizes = [change_size(track, column) for track in tracks]
    size = spread(sizes, unit=unit)
    return f"changes in {spread(shares, '{:.0f}', ' %')} of the steps, on average by {size} a step"


def _seconds(tracks: Sequence[Track]) -> list[float]:
    return [float(track.table["time_s"].iloc[-1]) for track in tracks]


def _path_m(track: Track) -> float:
    return float(np.hypot(np.diff(track.table["x_m"]), np.diff(track.table["y_m"])).sum())
