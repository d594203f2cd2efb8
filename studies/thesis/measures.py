"""Numbers that a figure shows, from the training runs of several seeds or from recorded maneuvers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from dockctl.analysis.episodes import from_initial_poses
from dockctl.reports.plan_view import Track
from dockctl.runs.tables import RECENT
from dockctl.scenarios.schema import Task
from studies.thesis.data import ArchivedRun, Facts, FigureFact
from studies.thesis.text import listed, share, spread

TOP_SHARE = 0.9
"""Share of its top speed that counts as top speed."""
ALL_TRACKS = ("pose", "intermediate")
"""Measures that include failures; the others are of the maneuvers that dock."""

Row = dict[str, str]


def training_rows(facts: Facts, name: str, runs: Sequence[ArchivedRun]) -> list[Row]:
    """The figures of a training run in the thesis, and the same measures of our runs."""
    return [
        {
            "Fig.": fact.figure,
            "thesis": fact.thesis,
            "here": OF_TRAININGS[fact.measure](runs),
            "why they differ": facts.why(fact),
        }
        for fact in facts.training[name]
    ]


def maneuver_rows(facts: Facts, name: str, sets: Mapping[str, tuple[Sequence[Track], Task]]) -> list[Row]:
    """The figures of a maneuver in the thesis, and the same measures of each set of maneuvers."""

    def measured(fact: FigureFact, tracks: Sequence[Track], task: Task) -> str:
        counted = tracks if fact.measure in ALL_TRACKS else [track for track in tracks if track.docked]
        return OF_MANEUVERS[fact.measure](counted, task) if counted else "-"

    return [
        {
            "Fig.": fact.figure,
            "thesis": fact.thesis,
            **{who: measured(fact, *found) for who, found in sets.items()},
            "why they differ": facts.why(fact),
        }
        for fact in facts.maneuvers[name]
    ]


def slowing_m(track: Track) -> float:
    """Distance to the last goal at which the boat is at top speed for the last time [m]."""
    rows = track.table
    if (switch := track.switch) is not None:
        rows = rows.iloc[switch:]
    speed = np.hypot(rows["u_mps"].to_numpy(float), rows["v_mps"].to_numpy(float))
    fast = np.flatnonzero(speed >= TOP_SHARE * speed.max())
    return float(rows["distance_m"].iloc[int(fast[-1])])


def ending(tracks: Iterable[Track]) -> str:
    """Outcomes of recorded episodes as text."""
    return listed(str(track.table["outcome"].iloc[-1]) for track in tracks)


def change_share(track: Track, column: str) -> float:
    """Share of the control steps in which a command changes."""
    values = track.table[column].to_numpy()[1:]  # the first row is the state before the first command
    return float((np.diff(values) != 0).mean()) if len(values) > 1 else 0.0


def change_size(track: Track, column: str) -> float:
    """Mean absolute change of a command per control step."""
    values = track.table[column].to_numpy()[1:]
    return float(np.abs(np.diff(values)).mean()) if len(values) > 1 else 0.0


def reward(runs: Sequence[ArchivedRun]) -> str:
    first = [run.first_docked for run in runs if run.first_docked is not None]
    streaks = [run.best_streak() for run in runs]
    return (
        f"the greedy policy first docks after {spread(first, '{:,.0f}', ' steps')}; longest series of docked"
        f" episodes from an initial pose {spread(streaks, '{:,.0f}')}"
    )


def duration(runs: Sequence[ArchivedRun]) -> str:
    steps = [from_initial_poses(run.episodes)["steps"] for run in runs]
    limits = [run.run.task.max_steps for run in runs]
    full = [_first(rows.to_numpy(int) < limit) for rows, limit in zip(steps, limits, strict=True)]
    last = [float(rows.tail(RECENT).mean()) for rows in steps]
    return (
        f"{_spread_of_firsts(full)} episodes until the first one ends early; the last {RECENT} take"
        f" {spread(last, '{:.0f}', ' steps')}; {spread([len(run.episodes) for run in runs], '{:,}')}"
        " episodes in all"
    )


def epsilon(runs: Sequence[ArchivedRun]) -> str:
    last = [float(run.episodes["epsilon"].iloc[-1]) for run in runs]
    return f"{spread(last, '{:.2g}')} at the end of training"


def phase(runs: Sequence[ArchivedRun]) -> str:
    firsts = []
    for run in runs:
        rows = from_initial_poses(run.episodes)
        at = _first(rows["phase"].rolling(RECENT).mean().to_numpy(float) >= 0.5)
        firsts.append(None if at is None else int(rows["episode"].iloc[at]))
    return f"half of {RECENT} episodes pass the intermediate pose from episode {_spread_of_firsts(firsts)} on"


def pose(tracks: Sequence[Track], task: Task) -> str:
    docked = [track for track in tracks if track.docked]
    path = f", path {spread([_path_m(track) for track in docked], unit=' m')}" if docked else ""
    return f"{share(len(docked), len(tracks))} dock{path}"


def distance(tracks: Sequence[Track], task: Task) -> str:
    ends = [float(track.table["distance_m"].iloc[-1]) for track in tracks]
    return f"{spread(ends, '{:.2f}', ' m')} left after {spread(_seconds(tracks), '{:.0f}', ' s')}"


def intermediate(tracks: Sequence[Track], task: Task) -> str:
    times = [float(track.table["time_s"].iloc[row]) for track in tracks if (row := track.switch) is not None]
    missed = len(tracks) - len(times)
    parts = [
        f"intermediate pose after {spread(times, '{:.0f}', ' s')}" if times else "",
        f"{share(missed, len(tracks))} never reach the intermediate pose" if missed else "",
        distance(tracks, task),
    ]
    return "; ".join(filter(None, parts))


def heading(tracks: Sequence[Track], task: Task) -> str:
    ends = [abs(float(track.table["heading_error_deg"].iloc[-1])) for track in tracks]
    return f"{spread(ends, unit='°')} off at the end"


def turn(tracks: Sequence[Track], task: Task) -> str:
    """Time before the intermediate pose from which the heading stays within tolerance, and final heading."""
    width = np.degrees(task.intermediate_tolerance.heading)
    ahead = []
    for track in tracks:
        if (switch := track.switch) is not None:
            rows = track.table.iloc[:switch]
            off = np.flatnonzero(rows["heading_error_deg"].abs().to_numpy(float) > width)
            first = int(off[-1]) + 1 if len(off) else 0
            ahead.append(float(track.table["time_s"].iloc[switch] - track.table["time_s"].iloc[first]))
    return (
        f"within {width:.0f}° for the last {spread(ahead, '{:.1f}', ' s')} before the intermediate pose;"
        f" {heading(tracks, task)}"
    )


def velocity(tracks: Sequence[Track], task: Task) -> str:
    top = [float(np.hypot(track.table["u_mps"], track.table["v_mps"]).max()) for track in tracks]
    return (
        f"{spread(top, '{:.2f}', ' m/s')} at most; last at top speed"
        f" {spread([slowing_m(track) for track in tracks], unit=' m')} from the goal"
    )


def stop(tracks: Sequence[Track], task: Task) -> str:
    """Top speed, and how many end with thrust ahead, which stops a boat that moves astern."""
    away = [off for track in tracks if (off := _ahead_from_m(track)) is not None]
    ahead = f", from {spread(away, unit=' m')} on" if away else ""
    return f"{velocity(tracks, task)}; {share(len(away), len(tracks))} end with thrust ahead{ahead}"


def yaw(tracks: Sequence[Track], task: Task) -> str:
    return f"{spread([float(track.table['r_degps'].abs().max()) for track in tracks], unit='°/s')} at most"


def propeller(tracks: Sequence[Track], task: Task) -> str:
    return _changes(tracks, "propeller_n", " N")


def rudder(tracks: Sequence[Track], task: Task) -> str:
    return _changes(tracks, "rudder_deg", "°")


OF_TRAININGS: dict[str, Callable[[Sequence[ArchivedRun]], str]] = {
    measure.__name__: measure for measure in (reward, duration, epsilon, phase)
}
OF_MANEUVERS: dict[str, Callable[[Sequence[Track], Task], str]] = {
    measure.__name__: measure
    for measure in (pose, distance, intermediate, heading, turn, velocity, stop, yaw, propeller, rudder)
}


def _first(true: np.ndarray) -> int | None:
    """Index of the first true value."""
    return int(true.argmax()) if true.any() else None


def _spread_of_firsts(firsts: Sequence[int | None]) -> str:
    found = [first for first in firsts if first is not None]
    never = len(firsts) - len(found)
    return listed(
        filter(None, [spread(found, "{:,}") if found else "", f"never ({never} seeds)" if never else ""])
    )


def _ahead_from_m(track: Track) -> float | None:
    """Distance to the goal from which the thrust is ahead until the end [m]; None if it never is."""
    astern = np.flatnonzero(track.table["propeller_n"].to_numpy(float)[1:] <= 0)
    if not len(astern) or astern[-1] == len(track.table) - 2:
        return None
    return float(track.table["distance_m"].iloc[int(astern[-1]) + 1])


def _changes(tracks: Sequence[Track], column: str, unit: str) -> str:
    shares = [100 * change_share(track, column) for track in tracks]
    sizes = [change_size(track, column) for track in tracks]
    size = spread(sizes, unit=unit)
    return f"changes in {spread(shares, '{:.0f}', ' %')} of the steps, mean change {size} per step"


def _seconds(tracks: Sequence[Track]) -> list[float]:
    return [float(track.table["time_s"].iloc[-1]) for track in tracks]


def _path_m(track: Track) -> float:
    return float(np.hypot(np.diff(track.table["x_m"]), np.diff(track.table["y_m"])).sum())
