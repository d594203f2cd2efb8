"""Pages of the scenarios: poses, seeds, training and maneuver; untrained berths and starts; the marina."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from dockctl.analysis.statistics import describe_share
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    within_distance,
    within_heading,
)
from dockctl.drawing import palette
from dockctl.experiments.study import Experiment
from dockctl.reports.figures import overview
from dockctl.reports.plan_view import pose_names
from dockctl.reports.style import label
from dockctl.reports.success_map import map_figure
from dockctl.run_files import FAILURES, SCENARIO
from dockctl.runs.tables import START_KINDS
from dockctl.scenarios.base import Pose
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Task
from studies.thesis import curves, maneuvers
from studies.thesis.claims import POLICIES, seeds_docked
from studies.thesis.data import (
    TEST,
    Archive,
    ArchivedRun,
    Berth,
    Facts,
    Recording,
    ScenarioFact,
    count_outcomes,
)
from studies.thesis.measures import Row, ending, maneuver_rows, training_rows
from studies.thesis.page import Draw, Page, seed_rows, total
from studies.thesis.text import docked_share, listed, outcome_counts, share

MARINA = "marina"
WITHIN_M = (1.0, 2.0, 3.0, 5.0, 10.0)


def scenarios_page(facts: Facts, archive: Archive) -> Page:
    """Figs. 3.10 and 3.13-3.15, Tables 3.6 and 4.2 to 4.4."""
    rows, first = [], []
    for scenario in facts.scenarios:
        run = archive[scenario.name][0]
        first.append((f"scenario {scenario.number}", f"3.{12 + scenario.number}", run))
        rows.append(_pose_row(scenario.name, scenario.start_table, run.run.task, run.run.tests))
    for berth in facts.berths:
        if (recording := archive["s3"][0].transfer(berth.name)) is not None:
            rows.append(_pose_row(berth.name, berth.start_table, recording.task, ()))
    vessel = load(str(archive["s1"][0].folder / SCENARIO)).scenario.vessel
    figures: dict[str, Draw] = {
        "scenarios": lambda: maneuvers.starts_figure(first),
        "surge": lambda: maneuvers.surge_figure(vessel),
    }
    return Page("results/scenarios.md", "scenarios.md", {"poses": rows}, figures)


def _pose_row(name: str, table: str, task: Task, evaluated: Sequence[Pose]) -> Row:
    """Poses as (x, y, heading)."""
    return {
        "scenario": f"`{name}`",
        "table of the thesis": table,
        "initial": pose_names(task.initial),
        "intermediate": pose_names([task.intermediate]) if task.intermediate else "",
        "final": pose_names([task.final]),
        "evaluated from": pose_names(evaluated),
    }


def scenario_page(scenario: ScenarioFact, facts: Facts, archive: Archive) -> Page:
    """Seeds, training and maneuver of one scenario."""
    name, number = scenario.name, scenario.number
    runs = archive[name]
    first = runs[0]
    several = len(first.tracks) > 1
    task, scene = first.recording.task, first.recording.scene
    tracks = first.tracks if several else maneuvers.by_seed([(run.seed, run.recording) for run in runs])
    whose = f"seed {first.seed}, colors of the thesis" if several else "the best policy of every seed"
    every = [track for run in runs for track in run.tracks]
    cited = [fact.figure for fact in facts.maneuvers[name]]
    figures: dict[str, Draw] = {
        f"{name}-training": lambda: curves.training_figure(
            f"Scenario {number}: training", runs, [fact.figure for fact in facts.training[name]]
        ),
        f"{name}-maneuver": lambda: maneuvers.maneuver_figure(
            f"Scenario {number}: maneuver", whose, scene, task, tracks, cited
        ),
        f"{name}-overview": lambda: overview(first.run, first.episodes, first.tracks),
    }
    if several:
        figures[f"{name}-seeds"] = lambda: maneuvers.trajectories_figure(
            f"Scenario {number}: every seed",
            "the best policy of each",
            [(f"seed {run.seed}", run.recording) for run in runs],
        )
    evaluated = [pose_names([pose]) for pose in first.run.tests]
    starts = len(first.run.task.initial) > 1
    values = {
        "scenario": scenario,
        "stop": first.training["stop"],
        "random": first.resolved["evaluation"]["random_starts"],
        "seeds": seed_rows(runs),
        "starts": _start_rows(runs) if starts else [],
        "unselected": pose_names(p for p in first.run.task.initial if pose_names([p]) not in evaluated),
        "first_seed": first.seed,
        "training": training_rows(facts, name, runs),
        "whose": whose,
        "several": several,
        "maneuver": maneuver_rows(facts, name, {f"here, {len(runs)} seeds": (every, task)}),
    }
    return Page(f"results/scenario-{number}.md", "scenario.md", values, figures)


def _start_rows(runs: Sequence[ArchivedRun]) -> list[Row]:
    """Outcomes of the test starts around each initial pose, by seed and in total."""
    poses = [pose_names([pose]) for pose in runs[0].run.task.initial]
    found = [[count_outcomes(rows) for _, rows in run.test_starts_by_pose()] for run in runs]
    rows = [
        {"seed": str(run.seed), **dict(zip(poses, map(outcome_counts, counts), strict=True))}
        for run, counts in zip(runs, found, strict=True)
    ]
    totals = [outcome_counts(total(counts)) for counts in zip(*found, strict=True)]
    return [*rows, {"seed": "all", **dict(zip(poses, totals, strict=True))}]


def generalization_page(facts: Facts, archive: Archive) -> Page:
    """Figs. 4.31-4.37, 4.39, 4.40 and B.1-B.7."""
    figures: dict[str, Draw] = {}
    sets = []
    for who, title in POLICIES.items():
        first = archive[who][0]
        sets.append({"name": who, "title": title, "seed": first.seed})
        figures[f"{who}-map"] = partial(
            _map_figure, first, f"{title}, seed {first.seed}", facts.fails_beyond_m
        )
        figures[f"{who}-failures"] = partial(
            maneuvers.trajectories_figure,
            "The nearest failures (Figs. 4.39, 4.40)",
            f"{title}, the best policy of every seed",
            [_panel(*found) for found in _transfers(archive[who], FAILURES)],
        )
    mapped = [(title, run) for who, title in POLICIES.items() for run in archive[who]]
    values = {
        "berths": [_berth_section(berth, facts, archive, figures) for berth in facts.berths],
        "limits": listed(f"{radius:g} m ({section})" for radius, section in facts.fails_beyond_m.items()),
        "heading_limit": f"{SMALL_OFFSET_DEG:g}",
        "reach": [_reach_row(title, run) for title, run in mapped],
        "outcomes": [_map_row(title, run) for title, run in mapped],
        "sets": sets,
    }
    return Page("results/generalization.md", "generalization.md", values, figures)


def _map_figure(run: ArchivedRun, caption: str, fails_beyond_m: Mapping[float, str]) -> Figure:
    """The success map, with the distances beyond which the thesis' policies fail."""
    figure = map_figure(run.map, run.run.scene, run.run.task, caption)
    by_distance = figure.subfigs[-1].axes[0]
    for distance, section in fails_beyond_m.items():
        by_distance.axvline(distance, color=palette.INK_SOFT, lw=1.0, ls=(0, (1, 2)), zorder=1)
        label(by_distance, section, (distance, 0.02), (3, 0), fontsize=7.5, color=palette.INK_SOFT)
    dotted = "dotted: beyond it the thesis' policies fail"
    by_distance.set_xlabel(f"{by_distance.get_xlabel()}   ({dotted})")
    return figure


def _berth_section(berth: Berth, facts: Facts, archive: Archive, figures: dict[str, Draw]) -> dict[str, Any]:
    """One untrained berth; adds its figures to `figures`."""
    cited = [fact.figure for fact in facts.maneuvers[berth.name]]
    numbers = f"Figs. {cited[0]} to {cited[-1]}"
    sets, measured = [], {}
    for who, title in POLICIES.items():
        found = _transfers(archive[who], berth.name)
        recording = found[0][1]
        name, heading = f"{who}-on-{berth.name}", f"{berth.title}: {title}"
        tracks = maneuvers.by_seed(found)
        if any(track.docked for track in tracks):
            figures[name] = partial(
                maneuvers.maneuver_figure,
                heading,
                "the best policy of every seed",
                recording.scene,
                recording.task,
                tracks,
                cited,
            )
        else:
            figures[name] = partial(
                maneuvers.trajectories_figure,
                f"{heading} ({numbers})",
                "the best policy of every seed",
                [_panel(*each) for each in found],
            )
        docked = share(*seeds_docked(archive[who], berth.name))
        sets.append({"title": title[0].upper() + title[1:], "figure": name, "docked": docked})
        measured[title] = ([track for _, each in found for track in each.tracks], recording.task)
    rows = maneuver_rows(facts, berth.name, measured)
    outcomes = [
        {
            "policies": title,
            "seed": str(run.seed),
            "the pose": outcome_counts(run.outcomes(("pose",), berth.name)),
            "random starts": outcome_counts(run.outcomes(("random",), berth.name)),
        }
        for who, title in POLICIES.items()
        for run in archive[who]
    ]
    return {"title": berth.title, "numbers": numbers, "sets": sets, "rows": rows, "outcomes": outcomes}


def _transfers(runs: Sequence[ArchivedRun], name: str) -> list[tuple[int, Recording]]:
    return [(run.seed, recording) for run in runs if (recording := run.transfer(name)) is not None]


def _panel(seed: int, recording: Recording) -> tuple[str, Recording]:
    return f"seed {seed}: {ending(recording.tracks)}", recording


def _reach_row(title: str, run: ArchivedRun) -> Row:
    free = within_heading(free_starts(run.map), SMALL_OFFSET_DEG)
    row = {"policies": title, "seed": str(run.seed), "success radius": format_radius(run.success_radius())}
    for limit in WITHIN_M:
        near = within_distance(free, limit)
        row[f"docked within {limit:g} m"] = share(int(near["docked"].sum()), len(near))
    return row


def _map_row(title: str, run: ArchivedRun) -> Row:
    """Outcomes of the free starts at every heading, before and after the intermediate pose."""
    free = free_starts(run.map)
    row = {"policies": title, "seed": str(run.seed), "free starts": f"{len(free):,}"}
    row["docked"] = f"{free['docked'].sum():,}"
    for phase, when in enumerate(("before", "after")):
        for outcome in ("collision", "timeout"):
            ended = (free["outcome"] == outcome) & (free["phase"] == phase)
            row[f"{outcome} {when} the intermediate pose"] = f"{ended.sum():,}"
    return row


def marina_page(facts: Facts, archive: Archive) -> Page:
    """Random starts at random berths, a third of them held out."""
    runs = archive[MARINA]
    (experiment,) = (e for e in archive.study.experiments if e.name == MARINA)
    every = pd.concat([run.evaluation() for run in runs])
    held_out = every[every["start_kind"] == "held_out"].groupby("berth")
    by_berth = sorted(((str(berth), rows) for berth, rows in held_out), key=_berth_order)
    values = {
        "seeds": seed_rows(runs),
        "berths": [row for run in runs for row in _berth_rows(run)],
        "by_berth": [{"held-out berth": berth, **_success(rows)} for berth, rows in by_berth],
        "transfer": [_transfer_row(experiment, run) for run in runs],
    }
    figures: dict[str, Draw] = {
        "marina-training": lambda: curves.training_figure("Marina: training", runs, ("", "", ""))
    }
    return Page("results/marina.md", "marina.md", values, figures)


def _berth_rows(run: ArchivedRun) -> Iterator[Row]:
    evaluation = run.evaluation()
    for kind in evaluation["start_kind"].unique():
        use = "test" if kind in TEST else "selection"
        rows = evaluation[evaluation["start_kind"] == kind]
        yield {"seed": str(run.seed), "starts": f"{START_KINDS[str(kind)]} ({use})", **_success(rows)}


def _success(rows: pd.DataFrame) -> Row:
    counts = count_outcomes(rows)
    _, _, interval = describe_share(counts["docked"], len(rows))
    return {
        "docked": docked_share(counts),
        "95 % interval": interval,
        "collisions": str(counts["collision"]),
        "timeouts": str(counts["timeout"]),
    }


def _berth_order(entry: tuple[str, pd.DataFrame]) -> tuple[str, float, int]:
    """Order berths, named like ``east -9 mirrored``, by quay and position."""
    side, position, *mirrored = entry[0].split()
    return side, float(position), len(mirrored)


def _transfer_row(experiment: Experiment, run: ArchivedRun) -> Row:
    row = {"seed": str(run.seed)}
    for name in experiment.evaluate_on:
        for kind, words in START_KINDS.items():
            if (counts := run.outcomes((kind,), name)) is not None:
                row[f"{name}, {'pose' if kind == 'pose' else words}"] = outcome_counts(counts)
    return row
