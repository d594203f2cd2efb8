"""What a page consists of, and table rows that several pages share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from matplotlib.figure import Figure

from dockctl.runs.tables import RECENT
from studies.thesis.data import SELECTION, TEST, ArchivedRun
from studies.thesis.measures import Row
from studies.thesis.text import docked_share, middle, outcome_counts, share, steps

Draw = Callable[[], Figure]


@dataclass(frozen=True)
class Page:
    """A page below ``docs``.

    Attributes:
        values: of the names in the template.
        figures: drawn on demand, by file name without suffix.
        used: archived runs that the page shows, by experiment.
    """

    path: str
    template: str
    values: Mapping[str, Any]
    figures: Mapping[str, Draw] = field(default_factory=dict)
    used: Mapping[str, Sequence[ArchivedRun]] = field(default_factory=dict)


def seed_rows(runs: Sequence[ArchivedRun]) -> list[Row]:
    """One row per seed, and one with the interquartile means."""
    rows = []
    for run in runs:
        clearance, time = run.of_docked("clearance_m"), run.of_docked("time_s")
        rows.append(
            {
                "seed": str(run.seed),
                "greedy policy first docks at": steps(run.first_docked),
                "training": f"{run.steps:,} steps",
                "episodes": f"{len(run.episodes):,}",
                "minutes": f"{run.minutes:.1f}",
                f"docked of the last {RECENT}": str(run.recent_docked),
                "selection episodes docked": docked_share(run.outcomes(SELECTION)),
                "test starts": outcome_counts(run.outcomes(TEST)),
                "mean time": f"{time.mean():.1f} s" if len(time) else "-",
                "minimum clearance": f"{clearance.min():.2f} m" if len(clearance) else "-",
            }
        )
    firsts = [run.first_docked for run in runs if run.first_docked is not None]
    times = [float(time.mean()) for run in runs if len(time := run.of_docked("time_s"))]
    rows.append(
        {
            "seed": "interquartile mean",
            "greedy policy first docks at": middle(firsts) if firsts else "never",
            "training": middle([run.steps for run in runs]),
            "episodes": middle([len(run.episodes) for run in runs]),
            "minutes": middle([run.minutes for run in runs], "{:.1f}"),
            "mean time": middle(times, "{:.1f}") + " s" if times else "-",
        }
    )
    return rows


def training_outcomes(runs: Sequence[ArchivedRun]) -> Row:
    """Results of the training runs of one experiment, by seed."""
    ends = [run.episodes["outcome"].tail(RECENT).value_counts() for run in runs]
    return {
        "seeds": str(len(runs)),
        "mastered": mastered(runs),
        "greedy policy first docks at": ", ".join(steps(run.first_docked) for run in runs),
        "training steps": ", ".join(f"{run.steps:,}" for run in runs),
        f"docked of the last {RECENT}": ", ".join(str(end.get("docked", 0)) for end in ends),
        "collisions": ", ".join(str(end.get("collision", 0)) for end in ends),
        "timeouts": ", ".join(str(end.get("timeout", 0)) for end in ends),
        "test starts": ", ".join(outcome_counts(run.outcomes(TEST)) for run in runs),
    }


def mastered(runs: Sequence[ArchivedRun]) -> str:
    """Runs that the stop rule ended; "-" where there is none."""
    ended = [run.mastered for run in runs if run.has_stop_rule]
    return share(sum(ended), len(ended)) if ended else "-"


def total(counts: Iterable[Mapping[str, int] | None]) -> dict[str, int]:
    found = [each for each in counts if each is not None]
    return {outcome: sum(each[outcome] for each in found) for outcome in found[0]} if found else {}
