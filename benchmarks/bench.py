"""Timing in alternating rounds, and reports as a table and as JSON, for all benchmarks.

Import it before numpy: it limits BLAS to one thread, so that measurements on one core use one core.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

from dockctl.runs.provenance import git_commit, hardware, now  # imports numpy

RESULTS = Path(__file__).parent / "results"
BUSY = 0.2  # cores used by other processes, above which wall-clock times are unreliable
LIBRARIES = (
    "numpy", "numba", "torch", "gymnasium", "trimesh", "embreex", "python-fcl", "stable-baselines3",
    "onnxruntime", "sbx-rl", "jax", "casadi",
)  # fmt: skip
console = Console()


@dataclass(frozen=True)
class Case:
    """A measured operation.

    Attributes:
        work: runs the operation `count` times.
        count: number of operations in one call of `work`.
        cores: work on one core is measured in CPU time, which other processes affect little; work on several
            cores in wall-clock time.
    """

    work: Callable[[], object]
    count: int = 1
    cores: int = 1

    def seconds(self) -> float:
        """Run the work once and return the time per operation [s]."""
        clock = time.process_time if self.cores == 1 else time.perf_counter
        begin = clock()
        self.work()
        return (clock() - begin) / self.count


def alternate(cases: Mapping[str, Case], rounds: int, what: str) -> dict[str, list[float]]:
    """Time the cases in turn for `rounds` rounds, after one round of warm-up [s]."""
    for case in cases.values():
        case.work()
    times: dict[str, list[float]] = {name: [] for name in cases}
    for _ in track(range(rounds), what, console=console, transient=True):
        for name, case in cases.items():
            times[name].append(case.seconds())
    return times


def ratio(times: Mapping[str, Sequence[float]], slow: str, fast: str) -> float:
    """Return the time of `slow` relative to that of `fast`: the median of the ratios of the rounds."""
    return statistics.median(a / b for a, b in zip(times[slow], times[fast], strict=True))


@dataclass(frozen=True)
class Target:
    """The required minimum or maximum of a measured value."""

    what: str
    value: float
    at_least: float | None = None
    at_most: float | None = None
    unit: str = ""

    @property
    def met(self) -> bool:
        """Whether the value is within its bound."""
        low = -float("inf") if self.at_least is None else self.at_least
        high = float("inf") if self.at_most is None else self.at_most
        return low <= self.value <= high

    @property
    def bound(self) -> str:
        """The bound as text."""
        sign, value = ("≥", self.at_least) if self.at_most is None else ("≤", self.at_most)
        return f"{sign} {value:g} {self.unit}".rstrip()


def busy_cores(seconds: float = 1.0) -> float:
    """Return the number of cores that other processes use while this process sleeps."""
    return psutil.cpu_percent(seconds) / 100 * (psutil.cpu_count() or 1)


@dataclass
class Report:
    """The results of one script: times, targets, other figures, machine and versions."""

    name: str
    title: str
    seconds: dict[str, list[float]] = field(default_factory=dict)
    targets: list[Target] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    load: float = field(default_factory=busy_cores)
    niceness: int = field(default_factory=lambda: os.nice(0))

    def write(self) -> None:
        """Print the targets, and write ``results/<name>.json``."""
        table = Table(title=self.title, box=box.SIMPLE_HEAD, header_style="bold", title_justify="left")
        for heading in ("", "measured", "target", ""):
            table.add_column(heading, justify="right" if heading in ("measured", "target") else "left")
        for target in self.targets:
            verdict = "met" if target.met else "missed"
            table.add_row(target.what, f"{target.value:,.4g} {target.unit}".rstrip(), target.bound, verdict)
        console.print(table)
        if self.load > BUSY:
            console.print(
                f"The machine was busy (other processes used {self.load:.1f} cores):"
                " times on several cores are unreliable."
            )
        RESULTS.mkdir(exist_ok=True)
        path = RESULTS / f"{self.name}.json"
        path.write_text(json.dumps(self.to_json(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        console.print(str(path), highlight=False, soft_wrap=True)

    def to_json(self) -> dict[str, Any]:
        """Return the report as JSON data."""
        return {
            "title": self.title,
            "when": now(),
            "commit": git_commit(),
            "load": round(self.load, 2),
            "niceness": self.niceness,
            "hardware": hardware(),
            "python": platform.python_version(),
            "libraries": {name: found for name in LIBRARIES if (found := installed(name))},
            "seconds": {name: summary(values) for name, values in self.seconds.items()},
            "targets": [
                {
                    "what": target.what,
                    "value": target.value,
                    "target": target.bound,
                    "unit": target.unit,
                    "met": target.met,
                }
                for target in self.targets
            ],
            "facts": self.facts,
        }


def summary(values: Sequence[float]) -> dict[str, float]:
    """Return the median, minimum and maximum of the rounds."""
    return {"median": statistics.median(values), "min": min(values), "max": max(values)}


def installed(library: str) -> str | None:
    """Return the version of a library, or None."""
    try:
        return version(library)
    except PackageNotFoundError:
        return None
