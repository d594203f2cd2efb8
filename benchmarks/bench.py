"""Measure alternating, tell in a table, keep as JSON: what the benchmarks have in common.

Import it before numpy: it holds the linear algebra to one thread, so that "one core" means one core.
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

from dockctl.runs.provenance import hardware, now

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

RESULTS = Path(__file__).parent / "results"
BUSY = 0.2  # cores that others keep busy, beyond which times by the clock on the wall say little
LIBRARIES = (
    "numpy", "numba", "torch", "gymnasium", "trimesh", "embreex", "python-fcl", "stable-baselines3",
    "onnxruntime", "sbx-rl", "jax",
)  # fmt: skip
console = Console()


@dataclass(frozen=True)
class Case:
    """Something to time.

    Attributes:
        work: does it `count` times.
        count: by which the time is divided.
        cores: work on one core is timed by the processor's time, which other processes disturb little;
            work on several by the clock on the wall.
    """

    work: Callable[[], object]
    count: int = 1
    cores: int = 1

    def seconds(self) -> float:
        clock = time.process_time if self.cores == 1 else time.perf_counter
        begin = clock()
        self.work()
        return (clock() - begin) / self.count


def alternate(cases: Mapping[str, Case], rounds: int, what: str) -> dict[str, list[float]]:
    """Time the cases one after the other, `rounds` times over, after one round that does not count [s]."""
    for case in cases.values():
        case.work()
    times: dict[str, list[float]] = {name: [] for name in cases}
    for _ in track(range(rounds), what, console=console, transient=True):
        for name, case in cases.items():
            times[name].append(case.seconds())
    return times


def ratio(times: Mapping[str, Sequence[float]], slow: str, fast: str) -> float:
    """Return how many times as long `slow` takes as `fast`: the median over the rounds of their ratio."""
    return statistics.median(a / b for a, b in zip(times[slow], times[fast], strict=True))


@dataclass(frozen=True)
class Bar:
    """What a measured value must reach, from below or from above."""

    what: str
    value: float
    at_least: float | None = None
    at_most: float | None = None
    unit: str = ""

    @property
    def reached(self) -> bool:
        low = -float("inf") if self.at_least is None else self.at_least
        high = float("inf") if self.at_most is None else self.at_most
        return low <= self.value <= high

    @property
    def demand(self) -> str:
        sign, bound = ("≥", self.at_least) if self.at_most is None else ("≤", self.at_most)
        return f"{sign} {bound:g} {self.unit}".rstrip()


def cores_kept_busy(seconds: float = 1.0) -> float:
    """Return how many cores others keep busy while this process sleeps; a load average remembers more."""
    return psutil.cpu_percent(seconds) / 100 * (psutil.cpu_count() or 1)


@dataclass
class Report:
    """The results of one script: what was measured, on what, and whether it is enough."""

    name: str
    title: str
    seconds: dict[str, list[float]] = field(default_factory=dict)
    bars: list[Bar] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)
    load: float = field(default_factory=cores_kept_busy)
    niceness: int = field(default_factory=lambda: os.nice(0))

    def tell(self) -> None:
        """Print the bars, and write ``results/<name>.json``."""
        table = Table(title=self.title, box=box.SIMPLE_HEAD, header_style="bold", title_justify="left")
        for heading in ("", "measured", "bar", ""):
            table.add_column(heading, justify="right" if heading in ("measured", "bar") else "left")
        for bar in self.bars:
            verdict = "reached" if bar.reached else "missed"
            table.add_row(bar.what, f"{bar.value:,.4g} {bar.unit}".rstrip(), bar.demand, verdict)
        console.print(table)
        if self.load > BUSY:
            console.print(
                f"The machine was busy ({self.load:.1f} cores at other work):"
                " times on several cores say little."
            )
        RESULTS.mkdir(exist_ok=True)
        path = RESULTS / f"{self.name}.json"
        path.write_text(json.dumps(self.to_json(), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        console.print(str(path), highlight=False, soft_wrap=True)

    def to_json(self) -> dict[str, Any]:
        return {
            "title": self.title,
            "when": now(),
            "load": round(self.load, 2),
            "niceness": self.niceness,
            "hardware": hardware(),
            "python": platform.python_version(),
            "libraries": {name: found for name in LIBRARIES if (found := installed(name))},
            "seconds": {name: summary(values) for name, values in self.seconds.items()},
            "bars": [
                {
                    "what": bar.what,
                    "value": bar.value,
                    "demand": bar.demand,
                    "unit": bar.unit,
                    "reached": bar.reached,
                }
                for bar in self.bars
            ],
            "facts": self.facts,
        }


def summary(values: Sequence[float]) -> dict[str, float]:
    """Return the median of the rounds, and the least and the greatest of them."""
    return {"median": statistics.median(values), "least": min(values), "greatest": max(values)}


def installed(library: str) -> str | None:
    """Return the version of a library, or None."""
    try:
        return version(library)
    except PackageNotFoundError:
        return None
