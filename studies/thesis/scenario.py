"""The pages of the three scenarios: every seed, the training, the maneuver."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from matplotlib.figure import Figure

from dockctl.analysis.trajectories import pose_label
from dockctl.reports.figures import overview
from dockctl.scenarios.base import Pose
from dockctl.scenarios.loader import load
from dockctl.scenarios.schema import Task
from studies.thesis import courses, curves
from studies.thesis.kept import Course, Kept, Kepts
from studies.thesis.markdown import picture, table
from studies.thesis.page import (
    Draw,
    Page,
    course_readings,
    missing,
    seeds_table,
    text_of,
    training_readings,
)
from studies.thesis.thesis import COURSES, TRAINING


@dataclass(frozen=True)
class Chapter:
    """A scenario of the thesis."""

    number: int
    section: str
    about: str

    @property
    def name(self) -> str:
        return f"s{self.number}"


CHAPTERS = (
    Chapter(1, "4.1", "One start, aligned with the berth: (20, 2, 160°) to (36, 0, 180°)."),
    Chapter(2, "4.2", "One of three starts before the berth, tested from the five poses of Table 4.3."),
    Chapter(3, "4.3", "The whole berthing: along the fairway to an intermediate pose, then in reverse."),
)
ENDING = """A training ends when the scenario is mastered: of the last 100 training episodes at least 95
docked, exploring starts among them, of those from the scenario's own initial poses at least as large a
share, and the last greedy evaluation docked from every test pose. The policy is the best one by greedy
evaluation. `random starts` begin up to 1 m and 10° off the initial poses, where these policies were not
trained."""


def scenario_pages(kept: Kepts) -> list[Page]:
    """The poses of the scenarios, and a page for each."""
    return [poses_page(kept), *(scenario_page(chapter, kept[chapter.name]) for chapter in CHAPTERS)]


def poses_page(kept: Kepts) -> Page:
    """Figs. 3.10 and 3.13-3.15."""
    first = [
        (f"scenario {c.number}", f"3.{12 + c.number}", kept[c.name][0]) for c in CHAPTERS if kept[c.name]
    ]
    head = "# The scenarios and the boat"
    if not first:
        names = [chapter.name for chapter in CHAPTERS]
        return Page("results/scenarios.md", text_of(head, missing(names)))
    vessel = load(first[0][2].folder / "scenario.yaml").scenario.vessel
    text = text_of(
        head,
        "Poses as in Table 3.6, but for the heading of 150° that it prints for the start of scenario 1 and"
        " the text gives as 160° (see [choices](../choices.md)). The harbor is ours.",
        picture("scenarios", "the poses of the three scenarios", 1),
        table(list(_poses(kept))),
        "## Surge",
        "The thesis' Fig. 3.10 shows about 0.4 m/s at 50 N; the same coefficients give the curve below.",
        picture("surge", "surge at full force", 1),
    )
    draws: dict[str, Draw] = {
        "scenarios": lambda: courses.starts_figure(first),
        "surge": lambda: courses.surge_figure(vessel),
    }
    return Page("results/scenarios.md", text, draws)


def _poses(kept: Kepts) -> Iterator[dict[str, str]]:
    """Tables 3.6 and 4.2 to 4.4, as the kept runs have them."""
    for chapter, numbers in zip(CHAPTERS, ("3.6", "4.2, 4.3", "3.6"), strict=True):
        for run in kept[chapter.name][:1]:
            yield _pose_row(chapter.name, numbers, run.run.task, run.run.tests)
    for name, numbers in (("s3-opposite", "4.4"), ("s3-appendix-b", "in pictures only")):
        for run in kept["s3"][:1]:
            if (course := run.course(name)) is not None:
                yield _pose_row(name, numbers, course.task, ())


def _pose_row(name: str, numbers: str, task: Task, tests: Sequence[Pose]) -> dict[str, str]:
    """Poses as (x, y, heading)."""

    def words(poses: Iterable[Pose]) -> str:
        return ", ".join(pose_label(pose.x_m, pose.y_m, pose.heading_deg) for pose in poses)

    return {
        "scenario": f"`{name}`",
        "thesis, Table": numbers,
        "initial": words(task.initial),
        "intermediate": words([task.intermediate]) if task.intermediate else "",
        "final": words([task.final]),
        "tested from": words(tests),
    }


def scenario_page(chapter: Chapter, runs: Sequence[Kept]) -> Page:
    """All seeds of a scenario."""
    path, name = f"results/scenario-{chapter.number}.md", chapter.name
    head = f"# Scenario {chapter.number}\n\n{chapter.about} Thesis: section {chapter.section}."
    if not runs:
        return Page(path, text_of(head, missing([name])))
    training, course = TRAINING[name], COURSES[name]
    task, scene = runs[0].run.task, runs[0].run.scene
    several = len(runs[0].tracks) > 1
    tracks = runs[0].tracks if several else courses.by_seed([(run.seed, run.tracks) for run in runs])
    every = [track for run in runs for track in run.tracks]
    whose = f"seed {runs[0].seed}, in the thesis' colors" if several else "the best policy of every seed"
    draws: dict[str, Draw] = {
        f"{name}-training": lambda: curves.training_figure(
            f"Scenario {chapter.number}: training", runs, [fact.figure for fact in training]
        ),
    }
    if tracks:
        draws[f"{name}-maneuver"] = lambda: courses.course_figure(
            f"Scenario {chapter.number}: maneuver",
            whose,
            scene,
            task,
            tracks,
            [fact.figure for fact in course],
        )
    first = runs[0]
    if first.tracks:
        draws[f"{name}-overview"] = lambda: overview(first.run, first.episodes, first.tracks)
    if several:
        draws[f"{name}-seeds"] = lambda: ways_of_seeds(f"Scenario {chapter.number}: every seed", runs)
    text = text_of(
        head,
        f"```sh\ndockctl reproduce {name}\n```",
        "## Every seed",
        ENDING,
        seeds_table(runs),
        picture(f"{name}-overview", f"seed {first.seed} at a glance") if first.tracks else "",
        "## Training",
        picture(f"{name}-training", "training of every seed"),
        training_readings(training, runs),
        "## Maneuver",
        picture(f"{name}-maneuver", whose) if tracks else "No training is over yet.",
        picture(f"{name}-seeds", "the ways of every seed") if several else "",
        course_readings(course, {f"here, {len(runs)} seeds": (every, task)}) if tracks else "",
    )
    return Page(path, text, draws)


def ways_of_seeds(title: str, runs: Sequence[Kept]) -> Figure:
    panels = [(f"seed {run.seed}", course) for run in runs if (course := _course_of(run))]
    return courses.ways_figure(title, "the best policy of each", panels)


def _course_of(run: Kept) -> Course | None:
    data = run.run
    return None if data.trajectories is None else Course(data.task, data.scene, data.trajectories)
