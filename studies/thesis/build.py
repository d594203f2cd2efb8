"""Write the results pages and their figures below ``docs``: ``make results``."""

from __future__ import annotations

import io
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from matplotlib.figure import Figure
from PIL import Image

from dockctl.experiments.study import Experiment, load_study
from dockctl.reports.style import figure_style
from dockctl.runs.files import write_atomically, writing
from studies.thesis.claims import claim_rows
from studies.thesis.data import SELECTION, TEST, Archive, ArchivedRun, Facts, load_facts
from studies.thesis.learner_pages import ablation_page, reward_page, thesis_learner_page, time_page
from studies.thesis.measures import Row
from studies.thesis.page import Page, mastered, total
from studies.thesis.scenario_pages import (
    MARINA,
    generalization_page,
    marina_page,
    scenario_page,
    scenarios_page,
)
from studies.thesis.text import docked_share, listed, outcome_counts, share, spread, table

ROOT = Path(__file__).parents[2]
RESULTS, DOCS = ROOT / "results" / "thesis", ROOT / "docs"
FIGURES = "figures/results"
WIDTH_PX = 1240
MAX_PX_PER_INCH = 110
COLORS = 255

Maker = Callable[[Facts, Archive], Page]


def rendered(results: Path = RESULTS) -> Iterator[tuple[Page, str]]:
    """Yield each page with its text, the overview last.

    Raises:
        DockctlError: an archived run is missing or damaged.
    """
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        undefined=StrictUndefined,
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    contents: list[tuple[str, str]] = []
    for page in pages_of(load_facts(), Archive(load_study("thesis"), results)):
        up = "../" * page.path.count("/")

        def picture(name: str, text: str, page: Page = page, up: str = up) -> str:
            if name not in page.figures:
                raise KeyError(f"{page.template}: no figure {name}")
            return f"![{text}]({up}{FIGURES}/{name}.png)"

        template = environment.get_template(page.template)
        text = template.render(
            page.values, table=table, picture=picture, archived=archived(page.used), pages=contents
        )
        contents.append((text.splitlines()[0].lstrip("# "), page.path))
        yield page, text


def pages_of(facts: Facts, archive: Archive) -> Iterator[Page]:
    """Yield every page in the order of the table of contents.

    Raises:
        DockctlError: an archived run is missing or damaged.
    """
    makers: list[Maker] = [
        scenarios_page,
        *(partial(scenario_page, scenario) for scenario in facts.scenarios),
        generalization_page,
        marina_page,
        reward_page,
        thesis_learner_page,
        ablation_page,
        time_page,
        results_page,
    ]
    for maker in makers:
        archive.used = {}
        page = maker(facts, archive)
        yield Page(page.path, page.template, page.values, page.figures, archive.used)


def results_page(facts: Facts, archive: Archive) -> Page:
    """Overview: claims, experiments, and the index of figures and tables."""
    experiments = [_experiment_row(e, archive[e.name]) for e in archive.study.experiments]
    runs = [run for e in archive.study.experiments for run in archive[e.name]]
    claims = claim_rows(facts, archive)
    held_out = [counts for run in archive[MARINA] if (counts := run.outcomes(("held_out",)))]
    provenance = runs[0].provenance
    libraries = ", ".join(f"{name} {version}" for name, version in provenance["libraries"].items())
    machines = {f"{run.provenance['processor']}, {run.provenance['cores']} cores" for run in runs}
    values = {
        "groups": listed(f"`{group}`" for group in dict.fromkeys(e.group for e in archive.study.experiments)),
        "machines": "; ".join(sorted(machines)),
        "versions": f"Python {provenance['python']}, {libraries}",
        "verdicts": Counter(row["verdict"] for row in claims),
        "claims": claims,
        "held_out": share(sum(c["docked"] for c in held_out), sum(sum(c.values()) for c in held_out)),
        "experiments": experiments,
        "index": [
            {
                "thesis": entry.thesis,
                "shows": entry.shows,
                "ours": f"[here]({entry.page})",
                "how they differ": entry.differs,
                "made by": f"`{entry.command}`",
            }
            for entry in facts.index
        ],
    }
    return Page("results.md", "results.md", values)


def _experiment_row(experiment: Experiment, runs: Sequence[ArchivedRun]) -> Row:
    return {
        "experiment": f"`{experiment.name}`",
        "about": experiment.title,
        "seeds": share(len(runs), experiment.seeds),
        "mastered": mastered(runs),
        "steps": spread([run.steps for run in runs], "{:,}"),
        "minutes": spread([run.minutes for run in runs]),
        "selection episodes docked": docked_share(total(run.outcomes(SELECTION) for run in runs)),
        "test starts": outcome_counts(total(run.outcomes(TEST) for run in runs)),
    }


def archived(used: Mapping[str, Sequence[ArchivedRun]]) -> str:
    """Which commits made the runs of a page."""
    experiments: dict[str, list[str]] = defaultdict(list)
    for name, runs in used.items():
        experiments[listed(f"`{commit}`" for commit in sorted({run.commit for run in runs}))].append(name)
    parts = [f"{commits} ({', '.join(names)})" for commits, names in experiments.items()]
    return f"Archived runs, by the commit that made them: {'; '.join(parts)}."


def png(figure: Figure) -> bytes:
    """A figure as a palette PNG of the size that a page needs."""
    full, small = io.BytesIO(), io.BytesIO()
    figure.savefig(full, format="png", metadata={"Software": None})
    with Image.open(full) as image:
        width = min(WIDTH_PX, round(MAX_PX_PER_INCH * figure.get_figwidth()))
        size = (width, image.height * width // image.width)
        resized = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
        resized.quantize(COLORS, kmeans=2).save(small, format="PNG", optimize=True)
    return small.getvalue()


def build(results: Path = RESULTS, docs: Path = DOCS) -> None:
    """Write all pages and figures; other files stay.

    Raises:
        DockctlError: an archived run is missing or damaged, or a file cannot be written.
    """
    pages = list(rendered(results))
    figures = docs / FIGURES
    with writing(docs):
        figures.mkdir(parents=True, exist_ok=True)
        (docs / "results").mkdir(exist_ok=True)
    for page, text in pages:
        print(write_atomically(docs / page.path, text.encode()))
        with figure_style():
            for name, draw in page.figures.items():
                write_atomically(figures / f"{name}.png", png(draw()))


if __name__ == "__main__":
    build()
