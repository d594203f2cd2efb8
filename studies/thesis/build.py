"""All the pages of the results, and the files that they are."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

from dockctl.reports.style import house_style
from dockctl.runs.files import write_atomically, writing
from dockctl.scenarios.study import Experiment, Study, load_study
from studies.thesis import claims, elsewhere, learner, scenario
from studies.thesis.kept import Kept, Kepts, read_results
from studies.thesis.markdown import NOT_RUN, listed, share, spread, table
from studies.thesis.page import Page, mastered, text_of
from studies.thesis.thesis import INDEX, Entry
from studies.thesis.time import time_page

FIGURES = Path("figures/results")
WIDTH_PX = 1240
MOST_PX_PER_INCH = 110
COLORS = 255


ROOT = Path(__file__).parents[2]


def pages_of(study: Study, results: Path) -> list[Page]:
    """Return every page, made from the study and the kept results alone.

    Raises:
        DockctlError: a kept file is broken.
    """
    kept = read_results(study, results)
    pages = [
        *scenario.scenario_pages(kept),
        elsewhere.generalization_page(kept),
        elsewhere.marina_page(study, kept),
        learner.reward_page(kept),
        learner.thesis_page(study, kept),
        learner.ablation_page(study, kept),
        time_page(kept),
    ]
    return [overview(study, kept, pages), *pages]


def write_pages(pages: list[Page], docs: Path) -> list[Path]:
    """Write texts and figures below `docs`; figures that no page shows any more go away.

    Raises:
        DockctlError: a file cannot be written.
    """
    written = []
    with writing(docs):
        (docs / FIGURES).mkdir(parents=True, exist_ok=True)
        (docs / "results").mkdir(exist_ok=True)
    shown = {f"{name}.png" for page in pages for name in page.figures}
    for stale in (docs / FIGURES).glob("*.png"):
        if stale.name not in shown:
            stale.unlink()
    for page in pages:
        with house_style():
            for name, draw in page.figures.items():
                written.append(write_atomically(docs / FIGURES / f"{name}.png", small_png(draw())))
        written.append(write_atomically(docs / page.path, page.text.encode()))
    return written


def small_png(figure: Figure) -> bytes:
    """A figure as a PNG that is small enough for a page."""
    full, small = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="png", metadata={"Software": None})
    with Image.open(full) as image:
        width = min(WIDTH_PX, round(MOST_PX_PER_INCH * figure.get_figwidth()))
        size = (width, image.height * width // image.width)
        resized = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        resized.quantize(COLORS, kmeans=2).save(small, format="PNG", optimize=True)
    return small.getvalue()


def overview(study: Study, kept: Kepts, pages: list[Page]) -> Page:
    """The first page: what there is, the claims, and where each figure of the thesis stands."""
    every = [run for runs in kept.values() for run in runs]
    groups = list(dict.fromkeys(experiment.group for experiment in study.experiments))
    text = text_of(
        "# Results",
        "Chapter 4 of the thesis and ours, side by side. These pages and their figures are written by"
        " `make results` from the small files of every run that are archived under `results/`: no"
        " number is typed by hand. All of it again, from nothing, interrupted as often as you like:",
        "```sh\ndockctl reproduce\n```",
        f"One part of it: `dockctl reproduce` with the names of experiments or of groups ({listed(groups)}).",
        _made_on(every),
        "## At a glance",
        table([_glance(experiment, kept[experiment.name]) for experiment in study.experiments]),
        "Full VLP-16 resolution everywhere; the terms and weights of Table 3.5, halved for the speed in"
        " scenario 3 as section 4.3 says, no `progress` term; δd in units of 20 m where nothing else is said"
        " ([why](results/reward.md)); what the thesis leaves open is settled in [choices](choices.md).",
        "## Claims",
        table(list(claims.rows(kept))),
        "## Every figure and table",
        table([_index_row(entry) for entry in INDEX]),
        "## Pages",
        "\n".join(f"- [{page.text.splitlines()[0].lstrip('# ')}]({page.path})" for page in pages),
    )
    return Page("results.md", text)


def _made_on(runs: list[Kept]) -> str:
    if not runs:
        return ""
    machines = sorted({f"{run.facts['processor']}, {run.facts['cores']} cores" for run in runs})
    commits = sorted({commit[:7] for run in runs if (commit := run.facts["git_commit"])})
    about = runs[0].facts
    libraries = ", ".join(f"{name} {version}" for name, version in about["libraries"].items())
    return (
        f"Seconds depend on the machine, everything else repeats bit for bit on the same one. Here:"
        f" {'; '.join(machines)}; Python {about['python']}, {libraries}; commits {', '.join(commits)}."
    )


def _glance(experiment: Experiment, runs: list[Kept]) -> dict[str, str]:
    row = {"experiment": f"`{experiment.name}`", "about": experiment.title}
    if not runs:
        return row | {"seeds": NOT_RUN}
    poses = [ended for run in runs if (ended := run.ended("pose") or run.ended("trained")) is not None]
    return row | {
        "seeds": f"{len(runs)} of {experiment.seeds}"
        + ("" if all(run.finished for run in runs) else ", under way"),
        "mastered": mastered(runs),
        "steps": spread([run.steps for run in runs], "{:,}"),
        "minutes": spread([run.minutes for run in runs]),
        "test poses docked": share((sum(k for k, _ in poses), sum(n for _, n in poses)) if poses else None),
    }


def _index_row(entry: Entry) -> dict[str, str]:
    return {
        "thesis": entry.numbers,
        "shows": entry.shows,
        "ours": f"[here]({entry.page})",
        "how they differ": entry.differs,
        "made by": f"`{entry.command}`",
    }


def main() -> None:
    """Write the pages from ``results/thesis`` to ``docs``."""
    for path in write_pages(pages_of(load_study("thesis"), ROOT / "results" / "thesis"), ROOT / "docs"):
        if path.suffix == ".md":
            print(path.relative_to(ROOT))


if __name__ == "__main__":
    main()
