"""Keep the small files of finished runs, and write the pages from what is kept."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from dockctl.console import say
from dockctl.experiments.archive import keep
from dockctl.experiments.jobs import jobs_of
from dockctl.reports.pages.book import pages_of, write_pages
from dockctl.runs.directory import require_writable
from dockctl.runs.reader import read_table
from dockctl.scenarios.study import load_study


def publish(
    source: str, names: Sequence[str], out: Path, results: Path, docs: Path, *, unfinished: bool = False
) -> None:
    """Keep the runs of the experiments `names` below `out`; write the pages of the whole study.

    Args:
        unfinished: keep trainings that are under way, too.

    Raises:
        DockctlError: the study is wrong, a run is broken, or a folder cannot be written to.
    """
    console, study = Console(), load_study(source)
    for folder in (results, docs):
        require_writable(folder)
    experiments = [e for e in study.chosen(names) if (out / e.name).is_dir()]
    for job in jobs_of(experiments, out):
        under_way = filter(_has_been_judged, job.runs()) if unfinished else iter(())
        if run := job.finished() or next(under_way, None):
            kept = keep(run, results, job.experiment.name, job.seed)
            say(console, f"kept {kept}")
    with console.status("drawing the pages"):
        written = write_pages(pages_of(study, results), docs)
    for path in written:
        if path.suffix == ".md":
            say(console, str(path))


def _has_been_judged(run: Path) -> bool:
    """Whether a training got as far as its first evaluation; before that there is nothing to show."""
    return read_table(run / "timing.csv", ("env_steps", "wall_s")) is not None
