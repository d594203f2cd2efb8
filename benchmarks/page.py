"""Write docs/performance.md and its figures from the results of the benchmarks.

python benchmarks/page.py
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import fill

from bench import BUSY, RESULTS
from figures import Json, boats_figure, docking_figure, growth_figure, number, scan_figure
from matplotlib.figure import Figure
from sections import SECTIONS, table

from dockctl.reports.style import figure_style

DOCS = Path(__file__).parents[1] / "docs"
SCRIPTS = (
    "lidar", "reference", "environment", "cores", "growth", "learner", "gpu", "latency", "start", "training",
    "optimal_control",
)  # fmt: skip

OTHER_MACHINE = ("cores", "gpu")
"""Scripts that run on another machine, with many cores and a GPU."""


def results() -> dict[str, Json]:
    """Return the results of the scripts that have been run, by name."""
    paths = [RESULTS / f"{name}.json" for name in SCRIPTS]
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths if path.exists()}


def wrapped(block: str) -> str:
    """Wrap the lines of a paragraph; tables, titles and images are unchanged."""
    return (
        block
        if block.startswith(("|", "#", "!["))
        else fill(block, 110, break_on_hyphens=False, break_long_words=False)
    )


def targets_section(found: dict[str, Json]) -> str:
    def value(target: Json) -> str:
        """Return the value, with more digits if it would otherwise read like the target that it misses."""
        shown = f"{number(target['value'])} {target['unit']}".rstrip()
        hidden = not target["met"] and target["target"].endswith(f" {shown}")
        return f"{target['value']:.4g} {target['unit']}".rstrip() if hidden else shown

    rows = [
        [
            target["what"],
            value(target),
            target["target"],
            "yes" if target["met"] else "**no**",
        ]
        for result in found.values()
        for target in result["targets"]
    ]
    return "## Targets\n\n" + table(("", "measured", "target", "met"), rows)


def machine_section(found: dict[str, Json]) -> str:
    rows = [
        [
            f"`benchmarks/{name}.py`",
            result["when"].replace("T", " ").removesuffix("+00:00"),
            f"`{result['commit'][:7]}`" if result["commit"] else "",
            f"{result['hardware']['processor']}, {result['hardware']['cores']} cores",
            f"{result['load']:.1f}" + (" (busy)" if result["load"] > BUSY else ""),
        ]
        for name, result in found.items()
    ]
    missing = ", ".join(f"`benchmarks/{name}.py`" for name in SCRIPTS if name not in found)
    others = (result for name, result in found.items() if name not in OTHER_MACHINE)
    in_order = sorted(others, key=lambda result: result["when"])
    latest, versions = in_order[-1], {}
    for result in in_order:  # a script needs only some of them
        versions |= result["libraries"]
    libraries = ", ".join(f"{name} {version}" for name, version in versions.items())
    return f"""## Machine and method

{latest["hardware"]["platform"].split("-")[0]}; Python {latest["python"]}; {libraries}.

{table(("script", "time (UTC)", "commit", "machine", "cores used by other processes"), rows)}

Work on one core is measured in CPU time, which other processes affect little; work on several cores in
wall-clock time, which is unreliable on a busy machine. The compared variants alternate, and a ratio is the
median of the ratios of the rounds.{f" Without results: {missing}." if missing else ""}"""


FIGURES: dict[str, tuple[str, Callable[[Json], Figure]]] = {
    "scan": ("lidar", scan_figure),
    "growth": ("growth", growth_figure),
    "boats": ("environment", boats_figure),
    "docking": ("optimal_control", docking_figure),
}


def page(found: dict[str, Json]) -> Iterator[str]:
    yield "# Performance"
    yield (
        "Time and memory, compared with other libraries, and docking times, compared with optimal control."
        " `make bench` measures into `benchmarks/results/`,"
        " and `python benchmarks/page.py` writes this page and its figures from there;"
        " `benchmarks/training.py` and `benchmarks/optimal_control.py`, which take minutes,"
        " `benchmarks/gpu.py`, which needs a GPU, and `benchmarks/cores.py`, for a machine with many cores,"
        " are run separately."
    )
    yield targets_section(found)
    for name, section in SECTIONS.items():
        if name in found:
            yield section(found[name])
    yield machine_section(found)


def main() -> None:
    found = results()
    with figure_style():
        for name, (script, draw) in FIGURES.items():
            if script in found:
                path = DOCS / "figures" / f"performance-{name}.png"
                draw(found[script]).savefig(path, metadata={"Software": None})
                print(path)
    path = DOCS / "performance.md"
    blocks = "\n\n".join(page(found)).split("\n\n")
    path.write_text("\n\n".join(map(wrapped, blocks)) + "\n", encoding="utf-8")
    print(path)


if __name__ == "__main__":
    main()
