"""Write the report of a run, a study or a comparison, once or repeatedly during training."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from pathlib import Path

from dockctl.agents.progress import REASONS
from dockctl.errors import DockctlError
from dockctl.evaluation.loading import load_checkpoint
from dockctl.evaluation.policies import LoadedPolicy
from dockctl.evaluation.replay import page_data, replay
from dockctl.experiments.study import Experiment, Study, archived_study, load_study
from dockctl.reading import read_json
from dockctl.reports import replay as replay_page
from dockctl.reports.report import Page, run_page
from dockctl.reports.study_report import Trial, comparison_page, study_page
from dockctl.run_files import BEST, POLICY_JSON, PROVENANCE, RECORDING, SCENARIO, archived_name
from dockctl.runs.directory import RunDirectory
from dockctl.runs.files import exclusive_lock, write_atomically
from dockctl.runs.reader import SOURCES, read_run
from dockctl.scenarios.base import NAME

Note = Callable[[str], None]
ARCHIVED = f"{archived_name('*')}/{SCENARIO}"
"""Pattern of the scenarios of archived runs, in the folder of their experiment."""
RELOAD_S = 10
"""Time after which the browser reloads a page that follows a training run [s]."""
POLL_S = 2.0
UNFINISHED = "Training has not ended"
REST = 4
"""Pause between reports, as a multiple of the time that one takes, so that training is hardly slowed."""


def write_report(
    source: Path,
    out: Path | None,
    *,
    policy: LoadedPolicy | None = None,
    trust: bool = False,
    note: Note = print,
) -> Path:
    """Write the report of a run folder, the results of a study, or a comparison, and return its path.

    Args:
        source: a run folder or a recording, a folder of a study's results, or a file of
            ``dockctl compare --json``.
        out: the page; ``report-<name>.html`` by default.
        policy: the policy of a recording, for the replay; by default the policy of the run.
        trust: run the plugins of a received run for its replay.
        note: called with what is omitted from the page, and why.

    Raises:
        DockctlError: `source` is none of these, one of its files is damaged, or the page cannot be written.
    """
    if (source / SCENARIO).is_file():
        page, shown = _run_report(source), _replay(source, trust, note, policy)
    else:
        page, shown = _study_or_comparison(source), None
    return write_atomically(out or default_name(source), page.html(shown).encode())


def follow(source: Path, out: Path | None, *, trust: bool = False, note: Note = print) -> Path:
    """Rewrite the report of a training run until it ends, and return its path.

    Args:
        source: its run folder.
        out, trust, note: as for `write_report`.

    Raises:
        DockctlError: it is not a run folder, one of its files is damaged, or the page cannot be written.
    """
    run = RunDirectory.open(source)
    file = out or default_name(run.path)
    policy, shown, before, announced = None, None, None, False
    while True:
        began, ended = time.monotonic(), not _is_running(run)
        state = [(path.stat().st_mtime_ns, path.stat().st_size) for path in _tables(run.path)]
        if ended or state != before:
            if (best := _best(run)) != policy:
                policy, shown = best, _replay(run.path, trust, note)
            try:
                page = _run_report(run.path)
            except DockctlError as error:  # no row yet, or a table grew while it was read
                if ended or error.code not in ("not_found", "not_readable"):
                    raise
            else:
                write_atomically(file, page.html(shown, None if ended else RELOAD_S).encode())
                before = state
                if not announced:
                    note(f"{file}: follows {run.path}; Ctrl-C stops")
                    announced = True
        if ended:
            return file
        for _ in range(max(1, math.ceil(REST * (time.monotonic() - began) / POLL_S))):
            time.sleep(POLL_S)
            if not _is_running(run):  # do not delay the last page
                break


def default_name(source: Path) -> Path:
    """Return the name of the page of a source."""
    return Path(f"report-{source.resolve().name.removesuffix('.json')}.html")


def _tables(folder: Path) -> list[Path]:
    return [path for name in (*SOURCES, PROVENANCE) if (path := folder / name).is_file()]


def _is_running(run: RunDirectory) -> bool:
    """Return whether a process is training this run."""
    facts = run.read_json(PROVENANCE)
    if facts.get("finished") or facts.get("stop_reason"):
        return False
    try:
        with exclusive_lock(run.path):  # held during training, released if the process is killed
            return False
    except DockctlError as error:
        if error.code != "busy":
            raise
        return True


def _best(run: RunDirectory) -> str | None:
    """Return the hash of the best policy, if there is one yet."""
    try:
        return str(RunDirectory(run.checkpoint(BEST)).read_json(POLICY_JSON).get("sha256"))
    except DockctlError:
        return None


def _run_report(folder: Path) -> Page:
    run = RunDirectory.open(folder)
    facts = run.read_json(PROVENANCE) if (folder / PROVENANCE).is_file() else {}
    reason = REASONS.get(str(facts.get("stop_reason")), UNFINISHED)
    if (folder / RECORDING).is_file():
        reason = "A recording, without training"
    return run_page(read_run(folder), f"{reason}.")


def _replay(folder: Path, trust: bool, note: Note, policy: LoadedPolicy | None = None) -> str | None:
    """Return the page of the replay of the best policy, or None without one that can run."""
    if policy is None and not RunDirectory(folder).checkpoints(BEST):
        return None
    try:
        return replay_page.page(page_data(replay([policy or load_checkpoint(folder, trust=trust)])))
    except DockctlError as error:
        note(f"note: the 3-D replay is omitted: {error}")
        return None


def _study_or_comparison(path: Path) -> Page:
    """Return the report of a study or a comparison.

    Raises:
        DockctlError: the path is neither.
    """
    if path.is_file() and isinstance(content := read_json(path), dict) and "policies" in content:
        return comparison_page(content, path)
    if any(path.glob(f"*/{ARCHIVED}")):
        study = _study(path)
        trials = [trial for experiment in study.experiments if (trial := _trial(path, experiment)).runs]
        return study_page(study.title or study.name, path, trials)
    problem = "is none of these" if path.exists() else "no such file or folder"
    expected = "a run folder, the results of a study, or the file of dockctl compare --json"
    raise DockctlError(f"{path}: {problem}; expected {expected}", code="not_found")


def _study(folder: Path) -> Study:
    """Return the study of archived runs: archived with them, packaged, or derived from the folder names."""
    if archived := archived_study(folder):
        return archived
    try:
        return load_study(folder.resolve().name)
    except DockctlError:
        names = sorted({path.parent.parent.name for path in folder.glob(f"*/{ARCHIVED}")})
        if unknown := [name for name in names if not re.fullmatch(NAME, name)]:
            message = f"{folder / unknown[0]}: not the name of an experiment; rename or move the folder"
            raise DockctlError(message, code="invalid") from None
        experiments = tuple(Experiment(name=name, group=name, scenario=name) for name in names)
        return Study(title=f"Study {folder.resolve().name}", experiments=experiments)


def _trial(folder: Path, experiment: Experiment) -> Trial:
    runs = [read_run(folder / experiment.name / path) for path in _seeds(folder / experiment.name)]
    about = experiment.title or ", ".join(experiment.set)
    return Trial(experiment.name, experiment.group, about, runs)


def _seeds(folder: Path) -> list[str]:
    names = [path.parent.name for path in folder.glob(ARCHIVED)]
    return sorted(names, key=lambda name: (len(name), name))
