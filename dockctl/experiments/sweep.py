"""A sweep: one scenario trained with every combination of settings and several seeds."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from dockctl.console import count, make_table, numeric, print_table, print_text
from dockctl.errors import DockctlError
from dockctl.experiments.runner import Ending, run_jobs
from dockctl.experiments.study import Experiment, Job, make_jobs
from dockctl.run_files import EVALUATION
from dockctl.runs.files import require_writable
from dockctl.runs.results import read_results
from dockctl.runs.tables import START_KEYS, START_KINDS
from dockctl.scenarios.loader import load

Row = dict[str, Any]
MAX_COMBINATIONS = 1000
SEEDS = (
    "a sweep uses the seeds 0 to N-1, so that the same command finds and resumes its runs; give their number"
    " with --seeds N"
)
TOKENS = re.compile(r"""("[^"]*"|'[^']*')|([\[{(])|([\]})])|(,)|.""", re.DOTALL)
"""Quoted text, opening and closing brackets, commas, anything else."""


def values(setting: str) -> list[str]:
    """Return ``key=value`` for each value of ``key=value,value,...``.

    Commas in brackets or quotes belong to a value: ``a=[1,2],[3]`` has two values, ``a="1,2"`` has one.
    """
    key, equals, text = setting.partition("=")
    found, depth = [""], 0
    for token in TOKENS.finditer(text):
        _, opening, closing, comma = token.groups()
        depth += bool(opening) - bool(closing)
        if comma and depth <= 0:
            found.append("")
        else:
            found[-1] += token[0]
    return [f"{key}{equals}{value.strip()}" for value in found] if len(found) > 1 else [setting]


def is_sweep(settings: Sequence[str], seeds: int | None) -> bool:
    """Return whether these options describe a sweep: a number of seeds, or several values of a setting."""
    return seeds is not None or any(len(values(setting)) > 1 for setting in settings)


def experiments(scenario: str, settings: Sequence[str], seeds: int) -> list[Experiment]:
    """Return one experiment for each combination of the values of `settings`, named after its values.

    Raises:
        DockctlError: a value is empty or repeated, or there are too many combinations.
    """
    if any(re.match(r"training\.seed\s*=", setting) for setting in settings):
        raise DockctlError("--set training.seed: " + SEEDS)
    choices = [values(setting) for setting in settings]
    for setting, options in zip(settings, choices, strict=True):
        if len(options) > 1 and (len({*options}) < len(options) or any(o.endswith("=") for o in options)):
            raise DockctlError(f"--set {setting}: expected different values, separated by commas")
    combinations = list(product(*choices))
    if len(combinations) > MAX_COMBINATIONS:
        message = f"--set: {len(combinations):,} combinations, at most {MAX_COMBINATIONS:,}"
        raise DockctlError(message, code="out_of_range")
    varied = [i for i, options in enumerate(choices) if len(options) > 1]
    names = [_name([combination[i] for i in varied]) for combination in combinations]
    return [
        Experiment(
            name=name if names.count(name) == 1 else f"{number}-{name}",
            group="sweep",
            scenario=scenario,
            seeds=seeds,
            set=combination,
        )
        for number, (name, combination) in enumerate(zip(names, combinations, strict=True))
    ]


def _name(settings: Sequence[str]) -> str:
    """Return ``boats-8_gamma-0.9`` for training.boats=8 and training.gamma=0.9: the name of a folder."""
    split = (setting.partition("=") for setting in settings)
    parts = [f"{key.rpartition('.')[2]}-{value}" for key, _, value in split]
    return re.sub(r"[^\w.-]+", "-", "_".join(parts), flags=re.ASCII)[:50].strip("-._") or "all"


def sweep(
    scenario: str,
    settings: Sequence[str],
    seeds: int,
    out: Path,
    workers: int | None = None,
    *,
    steps: int | None = None,
    on_divergence: str | None = None,
    plugin_files: Sequence[Path] = (),
    device: str = "cpu",
    sim_device: str = "cpu",
    trust: bool = False,
    name: str | None = None,
    tags: Sequence[str] = (),
    log: Sequence[str] = (),
    seed: int | None = None,
    start_from: str | None = None,
) -> tuple[Ending, list[Row]]:
    """Train and evaluate every combination with the seeds 0 to `seeds` - 1; print and return a summary.

    Finished runs are not repeated, and interrupted ones are resumed.

    Args:
        scenario: name or file.
        settings: ``key=value`` or ``key=value,value,...``.
        out: folder of the runs, ``<scenario>/<combination>/<scenario>/<time>-seed<N>/``.
        workers: number of parallel runs; one per core by default.
        steps, on_divergence, plugin_files, device, sim_device, trust, name, tags, log: see
            `dockctl.experiments.training.train`.
        seed, start_from: not allowed in a sweep.

    Raises:
        DockctlError: a combination is invalid, `seed` or `start_from` is given, or the folder cannot be
            written.
    """
    if seed is not None:
        raise DockctlError(f"--seed: {SEEDS}")
    if start_from is not None:
        raise DockctlError("--from: a sweep trains from scratch; omit it, or train one policy")
    limits = {"training.total_steps": steps, "training.on_divergence": on_divergence}
    given = [f"{key}={value}" for key, value in limits.items() if value is not None]
    chosen = experiments(scenario, [*settings, *given], seeds)
    first = load(scenario, overrides=chosen[0].overrides(0), plugin_files=plugin_files, trust=trust)
    folder = out / first.scenario.name
    require_writable(folder)
    options = ["--device", device, "--sim-device", sim_device, *_repeated("--log", log)]
    labels = [*_repeated("--name", [] if name is None else [name]), *_repeated("--tag", tags)]
    console, jobs = Console(), make_jobs(chosen, folder, options, labels, plugin_files, trust)
    print_text(console, f"{count(len(chosen), 'combination')}, {count(seeds, 'seed')}; runs in {folder}")
    ending, done = run_jobs(console, jobs, workers)
    rows = summary(done)
    if rows:
        print_table(console, _table(rows))
    return ending, rows


def _repeated(option: str, given: Sequence[str]) -> list[str]:
    return [word for value in given for word in (option, value)]


def summary(jobs: Sequence[Job]) -> list[Row]:
    """Return, for each combination, the number of finished runs, and episodes and docked episodes by run."""
    rows: dict[str, Row] = {}
    for job in jobs:
        name = job.experiment.name
        row = rows.setdefault(name, {"combination": name, "runs": 0, "starts": {}})
        row["runs"] += 1
        for kind, facts in _evaluated(job):
            counts = row["starts"].setdefault(kind, {"docked": [], "episodes": []})
            for key, numbers in counts.items():
                numbers.append(facts[key])
    return [*rows.values()]


def _table(rows: Sequence[Row]) -> Table:
    shown = list(dict.fromkeys(kind for row in rows for kind in row["starts"]))
    table = make_table(
        "combination",
        *numeric("runs", *(START_KINDS[kind] for kind in shown)),
        title="Docked (worst to best seed)",
    )
    for row in rows:
        cells = (_docked(**row["starts"][kind]) if kind in row["starts"] else "-" for kind in shown)
        table.add_row(row["combination"], f"{row['runs']}", *cells)
    return table


def _evaluated(job: Job) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield kind of start and summary of the evaluation of a finished job."""
    if (run := job.finished()) is not None:
        facts = read_results(run / f"{EVALUATION}.json")
        for kind, key in START_KEYS.items():
            if facts.get(key):
                yield kind, facts[key]


def _docked(docked: Sequence[int], episodes: Sequence[int]) -> str:
    """Return the success rate of all runs together, and of the worst and best run if there are several."""
    shares = [part / whole for part, whole in zip(docked, episodes, strict=True) if whole]
    total = sum(docked) / sum(episodes)
    return f"{total:.0%}" + (f" ({min(shares):.0%} to {max(shares):.0%})" if len(shares) > 1 else "")
