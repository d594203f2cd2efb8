"""A page: its text, and the figures that it shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.figure import Figure

from dockctl.analysis.learning import RECENT
from dockctl.analysis.trajectories import Track
from dockctl.runs.tables import START_KINDS
from dockctl.scenarios.schema import Task
from studies.thesis.kept import Kept
from studies.thesis.markdown import NOT_RUN, share, spread, steps, table
from studies.thesis.measures import OF_COURSES, OF_TRAININGS
from studies.thesis.statistics import interquartile_mean, interval
from studies.thesis.thesis import Fact

Draw = Callable[[], Figure]
ALL_TRACKS = ("pose", "gate")
"""Measures that tell of failures, too; the others are of the maneuvers that dock."""


@dataclass(frozen=True)
class Page:
    """A page below ``docs`` and the figures that it shows, by name; they are drawn when asked for."""

    path: str
    text: str
    figures: Mapping[str, Draw] = field(default_factory=dict)


def text_of(*blocks: str) -> str:
    """Blocks with an empty line between them; empty blocks are left out."""
    return "\n\n".join(block for block in blocks if block) + "\n"


def missing(names: Iterable[str]) -> str:
    """Say that something was not run, and what would."""
    return f"*{NOT_RUN.capitalize()} yet:* `dockctl reproduce {' '.join(names)}`."


def training_readings(facts: Sequence[Fact], runs: Sequence[Kept]) -> str:
    """What the thesis saw in its figures of a training, and what we see."""
    return table(
        [
            {"Fig.": f.figure, "the thesis": f.seen, "here": OF_TRAININGS[f.measure](runs), "because": f.why}
            for f in facts
        ]
    )


def course_readings(facts: Sequence[Fact], sets: Mapping[str, tuple[Sequence[Track], Task]]) -> str:
    """What the thesis saw in its figures of a maneuver, and what we see of each set of maneuvers."""
    rows = []
    for fact in facts:
        row = {"Fig.": fact.figure, "the thesis": fact.seen}
        for name, (tracks, task) in sets.items():
            there = tracks if fact.measure in ALL_TRACKS else [t for t in tracks if t.docked]
            row[name] = OF_COURSES[fact.measure](there, task) if there else "-"
        rows.append(row | ({"because": fact.why} if fact.why else {}))
    return table(rows)


def seeds_table(runs: Sequence[Kept]) -> str:
    """A line for each seed, and one for their middle."""
    rows = [_seed_row(run) for run in runs]
    if len(runs) > 1:
        rows.append({"seed": "interquartile mean", **_middle(runs)})
    return table(rows)


def middle(values: Sequence[float], form: str = "{:,.0f}") -> str:
    """Interquartile mean and its 95 % bootstrap interval."""
    array = np.array(values, float)
    low, high = interval(array)
    return f"{form.format(interquartile_mean(array))} [{form.format(low)}, {form.format(high)}]"


def seeds_docked(runs: Sequence[Kept], scenario: str) -> tuple[int, int] | None:
    """Seeds that dock from every test pose of another scenario, of those tried; None where none was."""
    ended = [found for run in runs if (found := run.ended("pose", scenario)) is not None]
    return (sum(docked == count for docked, count in ended), len(ended)) if ended else None


def mastered(runs: Sequence[Kept]) -> str:
    """How many trainings ended by mastery; "-" where they were to go on to their last step."""
    judged = [run.mastered for run in runs if run.has_stop_rule]
    return share((sum(judged), len(judged))) if judged else "-"


def _seed_row(run: Kept) -> dict[str, str]:
    clearance, time = run.of_docked("clearance_m"), run.of_docked("time_s")
    return {
        "seed": str(run.seed) if run.finished else f"{run.seed}, under way",
        "greedy docks first at": f"{steps(run.first_docked)}",
        "training": f"{run.steps:,} steps",
        "episodes": f"{len(run.episodes):,}",
        "minutes": f"{run.minutes:.1f}",
        f"docked of the last {RECENT}": str(run.recent_docked),
        **{
            f"{words} docked": share(ended)
            for kind, words in START_KINDS.items()
            if (ended := run.ended(kind))
        },
        "mean time": spread([time.mean()], unit=" s") if len(time) else "-",
        "least clearance": spread([clearance.min()], "{:.2f}", " m") if len(clearance) else "-",
    }


def _middle(runs: Sequence[Kept]) -> dict[str, str]:
    firsts = [run.first_docked for run in runs if run.first_docked is not None]
    times = [float(time.mean()) for run in runs if len(time := run.of_docked("time_s"))]
    return {
        "greedy docks first at": middle(firsts) if firsts else "never",
        "training": middle([run.steps for run in runs]),
        "episodes": middle([len(run.episodes) for run in runs]),
        "minutes": middle([run.minutes for run in runs], "{:.1f}"),
        "mean time": middle(times, "{:.1f}") + " s" if times else "-",
    }
