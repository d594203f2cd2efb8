"""Where the policies were not trained: the other berths, starts far off, and the marina's held-out berths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd
from matplotlib.figure import Figure

from dockctl.analysis.statistics import wilson_interval
from dockctl.analysis.success_map import SMALL_OFFSET_DEG, format_radius, free_starts, within_heading
from dockctl.reports.success_map import THESIS_M, map_figure
from dockctl.runs.directory import FAILURES
from dockctl.runs.tables import START_KINDS
from dockctl.scenarios.study import Experiment, Study
from studies.thesis import courses, curves
from studies.thesis.kept import Course, Kept, Kepts
from studies.thesis.markdown import NOT_RUN, listed, picture, share, table
from studies.thesis.measures import ending
from studies.thesis.page import (
    Draw,
    Page,
    course_readings,
    missing,
    seeds_docked,
    seeds_table,
    text_of,
)
from studies.thesis.thesis import COURSES

FIXED, MARINA = "s3", "marina"
WHOSE = {FIXED: "scenario 3's policies", MARINA: "the marina's policies"}
BERTHS = {"s3-opposite": "The berth on the other side", "s3-appendix-b": "The berth of appendix B"}
WITHIN_M = (1.0, 2.0, 3.0, 5.0, 10.0)
Panels = Sequence[tuple[str, Course]]


def generalization_page(kept: Kepts) -> Page:
    """Figs. 4.31-4.37, 4.39, 4.40 and B.1-B.7."""
    blocks, draws = ["# Where they were not trained"], dict[str, Draw]()
    blocks.append(
        "The thesis trains one start and one berth, and finds that the same network docks at two berths that"
        " it never saw. Ours knows no direction to the goal but through the LiDAR, as theirs; the policies of"
        " the [marina](marina.md), trained at many berths, are told it."
    )
    for name, title in BERTHS.items():
        text, figures = _berth(name, title, kept)
        blocks.append(text)
        draws |= figures
    text, figures = _far_starts(kept)
    return Page("results/generalization.md", text_of(*blocks, text), draws | figures)


def _berth(name: str, title: str, kept: Kepts) -> tuple[str, dict[str, Draw]]:
    """One untrained berth: what became of every policy there."""
    facts = COURSES[name]
    sets = {who: [(run.seed, course) for run in kept[who] if (course := run.course(name))] for who in WHOSE}
    sets = {who: courses_there for who, courses_there in sets.items() if courses_there}
    numbers = f"Figs. {facts[0].figure} to {facts[-1].figure}"
    head = f"## {title}\n\nThesis: {numbers}."
    if not sets:
        return f"{head}\n\n{missing(WHOSE)}", {}
    draws: dict[str, Draw] = {}
    blocks = [head]
    for who, found in sets.items():
        tracks = courses.by_seed([(seed, course.tracks) for seed, course in found])
        course = found[0][1]
        figure = f"{who}-on-{name}"
        if any(track.docked for track in tracks):
            draws[figure] = _maneuver(
                f"{title}: {WHOSE[who]}", course, found, [fact.figure for fact in facts]
            )
        else:
            draws[figure] = _ways(f"{title}: {WHOSE[who]} ({numbers})", [_named(*one) for one in found])
        blocks.append(f"**{WHOSE[who].capitalize()}**: {share(seeds_docked(kept[who], name))} seeds dock.")
        blocks.append(picture(figure, f"{title}: {WHOSE[who]}"))
    readings = {
        WHOSE[who]: ([t for _, course in found for t in course.tracks], found[0][1].task)
        for who, found in sets.items()
    }
    blocks.append(course_readings(facts, readings))
    return "\n\n".join(blocks), draws


def _named(seed: int, course: Course) -> tuple[str, Course]:
    """A panel's title: whose episodes these are, and how they end."""
    return f"seed {seed}: {listed(ending(track) for track in course.tracks)}", course


def _maneuver(title: str, course: Course, found: Sequence[tuple[int, Course]], cited: Sequence[str]) -> Draw:
    tracks = courses.by_seed([(seed, there.tracks) for seed, there in found])
    return lambda: courses.course_figure(
        title, "the best policy of every seed", course.scene, course.task, tracks, cited
    )


def _ways(title: str, panels: Panels) -> Draw:
    return lambda: courses.ways_figure(title, "the best policy of every seed", panels)


def _far_starts(kept: Kepts) -> tuple[str, dict[str, Draw]]:
    """Success over starts around the trained one, and the nearest failures (Figs. 4.39, 4.40)."""
    head = "## How far from the trained start"
    rows = [_reach_row(who, run) for who in WHOSE for run in kept[who] if run.map is not None]
    if not rows:
        return f"{head}\n\n{missing(WHOSE)}", {}
    said = ", ".join(f"{radius:g} m ({section})" for radius, section in THESIS_M.items())
    blocks = [
        head,
        f"The thesis puts the limit at {said}, without saying how many starts were tried. Below: a grid of"
        f" free starts around the trained one, headings up to {SMALL_OFFSET_DEG:g}° askew; the success radius"
        " is the largest distance up to which every one of them docks.",
        table(rows),
    ]
    draws: dict[str, Draw] = {}
    for who in WHOSE:
        mapped = [run for run in kept[who] if run.map is not None]
        if mapped:
            draws[f"{who}-map"] = _map(mapped[0], who)
            blocks.append(picture(f"{who}-map", f"success over starts, {WHOSE[who]}, seed {mapped[0].seed}"))
    blocks += [
        "Figs. 4.39 and 4.40 show a collision after the intermediate pose was reached in a bad place, and a"
        " boat that never reaches it. How the free starts of the whole grid end here, at every heading:",
        table([_ends_row(who, run) for who in WHOSE for run in kept[who] if run.map is not None]),
        "Of every seed, the nearest start that collides, if there is one after the intermediate pose that"
        " one, and the nearest that never reaches it nor collides:",
    ]
    for who in WHOSE:
        panels = [
            _named(run.seed, course) for run in kept[who] if (course := run.course(FAILURES)) is not None
        ]
        if panels:
            draws[f"{who}-failures"] = _failures(who, panels)
            blocks.append(picture(f"{who}-failures", f"the nearest failures, {WHOSE[who]}"))
    return "\n\n".join(blocks), draws


def _failures(who: str, panels: Panels) -> Draw:
    return lambda: courses.ways_figure(
        "The nearest failures (Figs. 4.39, 4.40)", f"{WHOSE[who]}, the best of every seed", panels
    )


def _map(run: Kept, who: str) -> Draw:
    def draw() -> Figure:
        assert run.map is not None  # the caller has asked
        return map_figure(run.map, run.run.scene, run.run.task, f"{WHOSE[who]}, seed {run.seed}")

    return draw


def _reach_row(who: str, run: Kept) -> dict[str, str]:
    assert run.map is not None  # the caller has asked
    free = within_heading(free_starts(run.map), SMALL_OFFSET_DEG)
    row = {"policies": WHOSE[who], "seed": str(run.seed), "success radius": format_radius(run.radius())}
    for limit in WITHIN_M:
        near = free[free["offset_m"] <= limit + 1e-6]
        row[f"docked within {limit:g} m"] = share((int(near["docked"].sum()), len(near)))
    return row


def _ends_row(who: str, run: Kept) -> dict[str, str]:
    """How the free starts at every heading end, before and after the intermediate pose."""
    assert run.map is not None  # the caller has asked
    free = free_starts(run.map)
    row = {"policies": WHOSE[who], "seed": str(run.seed), "free starts": f"{len(free):,}"}
    row["docked"] = f"{free['docked'].sum():,}"
    for phase, when in enumerate(("before", "after")):
        for outcome, words in {"collision": "collided", "timeout": "out of time"}.items():
            ended = (free["outcome"] == outcome) & (free["phase"] == phase)
            row[f"{words} {when} the intermediate pose"] = f"{ended.sum():,}"
    return row


def marina_page(study: Study, kept: Kepts) -> Page:
    """Random starts at random berths, a third of them held out."""
    path, runs = "results/marina.md", kept[MARINA]
    experiments = [experiment for experiment in study.experiments if experiment.name == MARINA]
    head = (
        "# Marina\n\nPast the thesis: random starts at random berths of both sides, some of them held out."
        " The state has the bearing to the goal beside what the thesis gives it; reward and network are those"
        " of scenario 3, the learner's settings stand in [marina.yaml](../../scenarios/marina.yaml)."
    )
    if not runs:
        return Page(path, text_of(head, missing([MARINA])))
    draws: dict[str, Draw] = {
        "marina-training": lambda: curves.training_figure("Marina: training", runs, ("", "", ""))
    }
    text = text_of(
        head,
        f"```sh\ndockctl reproduce {MARINA}\n```",
        "## Every seed",
        seeds_table(runs),
        picture("marina-training", "training of every seed"),
        "## Trained and held-out berths",
        table([row for run in runs for row in _berth_rows(run)]),
        _by_berth(runs),
        "## The same networks elsewhere",
        *(elsewhere_table(experiment, runs) for experiment in experiments),
        "Starts farther off: [how far from the trained start]"
        "(generalization.md#how-far-from-the-trained-start).",
    )
    return Page(path, text, draws)


def elsewhere_table(experiment: Experiment, runs: Sequence[Kept]) -> str:
    """What became of every seed on the other scenarios."""
    rows = []
    for run in runs:
        row = {"seed": str(run.seed)}
        for name in experiment.evaluate_on:
            for kind, words in START_KINDS.items():
                if (ended := run.ended(kind, name)) is not None:
                    row[f"{name}, {words}"] = share(ended)
        rows.append(row)
    return table(rows)


def _berth_rows(run: Kept) -> list[dict[str, str]]:
    evaluation, rows = run.evaluation(), []
    if evaluation is None:
        return [{"seed": str(run.seed), "starts": NOT_RUN}]
    for kind in evaluation["start_kind"].unique():
        group = evaluation[evaluation["start_kind"] == kind]
        rows.append({"seed": str(run.seed), "starts": START_KINDS[str(kind)], **_success(group)})
    return rows


def _success(group: pd.DataFrame) -> Mapping[str, str]:
    ends = group["outcome"].value_counts()
    count = int(ends.get("docked", 0))
    low, high = wilson_interval(count, len(group))
    return {
        "docked": share((count, len(group))),
        "95 % interval": f"{low:.1%} to {high:.1%}",
        "collisions": str(ends.get("collision", 0)),
        "timeouts": str(ends.get("timeout", 0)),
    }


def _by_berth(runs: Sequence[Kept]) -> str:
    """Success at every held-out berth, all seeds together."""
    tables = [found for run in runs if (found := run.evaluation()) is not None and "berth" in found]
    if not tables:
        return ""
    every = pd.concat(tables)
    held_out = every[every["start_kind"] == "held_out"]
    groups = sorted(((str(berth), group) for berth, group in held_out.groupby("berth")), key=_along_the_quay)
    return table([{"held-out berth": berth, **_success(group)} for berth, group in groups]) if groups else ""


def _along_the_quay(entry: tuple[str, pd.DataFrame]) -> tuple[str, float, int]:
    """Order berths, named like ``east -9 mirrored``, by quay and place."""
    side, place, *mirrored = entry[0].split()
    return side, float(place), len(mirrored)
