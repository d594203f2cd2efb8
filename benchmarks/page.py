"""Write docs/performance.md and its figures from the results that the benchmarks left: no number is typed.

python benchmarks/page.py
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from textwrap import fill

from bench import BUSY, RESULTS
from figures import Json, boats_figure, growth_figure, number, ways_figure
from matplotlib.figure import Figure

from dockctl.reports.style import house_style

DOCS = Path(__file__).parents[1] / "docs"
SCRIPTS = ("lidar", "oracle", "environment", "growth", "learner", "gpu", "latency", "start", "training")
NO_GPU = " `benchmarks/gpu.py` has not been run: no graphics processor was at hand."


def results() -> dict[str, Json]:
    """Return what each script that has been run left, by its name."""
    paths = [RESULTS / f"{name}.json" for name in SCRIPTS]
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths if path.exists()}


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown; all columns but the first are right-aligned."""
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def wrapped(block: str) -> str:
    """Break a paragraph into lines; tables, titles and pictures stay as they are."""
    return (
        block
        if block.startswith(("|", "#", "!["))
        else fill(block, 110, break_on_hyphens=False, break_long_words=False)
    )


def bars_section(found: dict[str, Json]) -> str:
    rows = [
        [
            bar["what"],
            f"{number(bar['value'])} {bar['unit']}".rstrip(),
            bar["demand"],
            "yes" if bar["reached"] else "**no**",
        ]
        for result in found.values()
        for bar in result["bars"]
    ]
    return "## Ratios and bounds\n\n" + table(("", "measured", "bar", "reached"), rows)


def scan_section(lidar: Json) -> str:
    facts = lidar["facts"]
    return f"""## A scan

![ways to scan](figures/performance-ways.png)

The peer is embree by way of trimesh, asked for distances alone, with the sector ranges by numpy. The
fast scan keeps {number(facts["rays_mb"])} MB for the rays, shared by all harbors, and
{number(facts["harbor_mb"])} MB for each harbor."""


def oracle_section(oracle: Json) -> str:
    facts = oracle["facts"]
    return f"""The fast scan traces only what can matter and must equal the plain tracer bit for bit:
{facts["ranges_compared"]:,} ranges were compared, from {facts["poses"]:,} poses all over the basin, of which
{facts["touching"]:,} touch something or lie inside of it. Embree computes in single precision and differs
from the plain tracer by at most {number(facts["embree_off_mm"])} mm."""


def growth_section(growth: Json) -> str:
    rays, cuts = growth["facts"]["rays"], growth["facts"]["triangles"]
    by_rays, by_triangles, by_batch = (f"{bar['value']:.2f}" for bar in growth["bars"])

    def rows(points: list[Json], size: str) -> list[list[str]]:
        return [
            [
                f"{one[size]:,}",
                number(1e3 * one["dockctl"]["median"]),
                number(1e3 * one["peer"]["median"]),
                number(one["peer"]["median"] / one["dockctl"]["median"]),
                number(one["rays_mb"]),
                number(one["harbor_mb"]),
            ]
            for one in points
        ]

    head = ("dockctl [ms]", "embree [ms]", "ratio", "rays [MB]", "harbor [MB]")
    return f"""## How costs grow

![how costs grow](figures/performance-growth.png)

With the rays, a scan's time grows to the power of {by_rays}: a cell of the rings is looked up once for all
the rays that cross it, and only the rays that may hit something near a sector's best are walked. Twice the
rays find the nearest thing no later. With the triangles it grows to the power of {by_triangles}: the
grid's cells are as many as before, and a triangle is tested only at the heights at which it passes through
a cell.

{table(("rays", *head), rows(rays, "rays"))}

{table(("triangles", *head), rows(cuts, "triangles"))}

What limits it: about half of the time goes into walking rays through cells of 0.1 m and testing the
triangles there, the rest into finding out which rays to walk; both wait for memory, since every pose touches
another part of the tables. The next factor would be to walk eight rays with one instruction, which needs a
compiler with vector types; other sizes of cells and rings only move the cost from one part to the other.

An update of the learner grows with the batch to the power of {by_batch} over the sizes in the figure: a small
one pays for the optimizer's pass over the parameters, a large one for the products of its matrices, and
beyond some thousand transitions for outputs that no cache holds."""


def boats_section(environment: Json) -> str:
    facts = environment["facts"]
    timed = zip(facts["boats"], environment["seconds"].values(), facts["processor_seconds"], strict=True)
    rows = [
        [f"{boats:,}", f"{1 / wall['median']:,.0f}", number(1e6 * processor["median"]), number(held / 1e6)]
        for (boats, wall, processor), held in zip(timed, facts["held_bytes"], strict=True)
    ]
    return f"""## Boats side by side

![boats](figures/performance-boats.png)

{table(("boats", "steps a second", "processor [µs a boat and step]", "memory [MB]"), rows)}

A step of one boat through `gymnasium.make` takes {number(facts["one_step_ms"]["median"])} ms at the median
and {number(facts["one_step_ms"]["p99"])} ms at the 99th percentile. Few boats pay for
the calls from Python into the compiled parts and for threads that wait for the slowest scan; many boats pay
for the scan alone. Memory grows by {number(facts["held_bytes_a_boat"] / 1e3)} kB a boat, of which the state
is {number(facts["state_bytes_a_boat"] / 1e3)} kB; the rest are its generator and the last observation and
facts that were handed out.

What limits it: the scan. The next factor is more cores: boats do not depend on each other."""


def latency_section(latency: Json) -> str:
    facts = latency["facts"]
    rows = [
        [part.removesuffix("_ms").replace("_", " "), number(times["p50"]), number(times["p99"])]
        for part, times in facts["milliseconds"].items()
    ]
    return f"""## Latency

One boat, one core, {facts["decisions"]:,} decisions along greedy episodes [ms]:

{table(("part", "median", "99th percentile"), rows)}

What limits a decision is the scan; a forward pass is a few products of a row with a matrix."""


def learner_section(learner: Json) -> str:
    batches = {name: facts for name, facts in learner["facts"].items() if "updates_per_second" in facts}
    tables = [
        table(
            (name, "updates a second", "times as fast is dockctl"),
            [
                [peer, number(rate), number(facts["times_as_fast_as"].get(peer, 1.0))]
                for peer, rate in facts["updates_per_second"].items()
            ],
        )
        for name, facts in batches.items()
    ]
    shares = [f"{facts['share_of_the_arithmetic_bound']:.0%} at {name}" for name, facts in batches.items()]
    forward = learner["facts"]["forward"]["microseconds"].items()
    tables.append(table(("forward pass of one boat", "µs"), [[name, number(time)] for name, time in forward]))
    return "\n\n".join(
        [
            "## The learner",
            "One core. Against the arithmetic alone, the multiplications and additions of an update over the"
            f" rate at which this core multiplies large matrices, the update reaches {' and '.join(shares)}.",
            *tables,
            "What limits it: the products of matrices, which BLAS computes, and at small batches also the way"
            " into compiled code and the optimizer's pass over every parameter. The next factor is a graphics"
            " processor or half precision for large batches; at small ones there is only fewer and larger"
            " updates.",
        ]
    )


def start_section(start: Json) -> str:
    rows = [
        [case, *(number(seconds[of]) for of in ("least", "median", "greatest"))]
        for case, seconds in start["seconds"].items()
    ]
    return f"""## From the command to the first gradient step

Seconds until the first row of `updates.csv`; from nothing, the tables of every harbor are built and the inner
loops compiled, both kept for the next time:

{table(("", "least", "median", "greatest"), rows)}"""


def training_section(training: Json) -> str:
    rows = [
        [
            str(run["seed"]),
            f"{run['wall_s'] / 60:.1f}",
            f"{run['cores_used']:.2f}",
            f"{run['peak_memory_gb']:.2f}",
        ]
        for run in training["facts"]["runs"]
    ]
    head = ("seed", "minutes", "cores at work", "peak memory [GB]")
    return "## Scenario 3 from nothing to mastery\n\n" + table(head, rows)


def machine_section(found: dict[str, Json]) -> str:
    rows = [
        [
            f"`benchmarks/{name}.py`",
            result["when"].replace("T", " ").removesuffix("+00:00"),
            f"{result['load']:.1f}" + (" (busy)" if result["load"] > BUSY else ""),
            str(result.get("niceness", 0)),
        ]
        for name, result in found.items()
    ]
    latest = max(found.values(), key=lambda result: result["when"])
    libraries = ", ".join(f"{name} {version}" for name, version in latest["libraries"].items())
    machine = latest["hardware"]
    return f"""## Machine

{machine["processor"]}, {machine["cores"]} cores, {machine["platform"]}; Python {latest["python"]};
{libraries}.

{table(("script", "when (UTC)", "cores at other work before", "niceness"), rows)}

Work on one core is timed by the processor's time, which other processes disturb little; work on several
cores by the clock on the wall, which says little on a busy machine. Candidates take turns within a round,
a ratio is the median of the rounds' ratios.{NO_GPU if "gpu" not in found else ""}"""


def gpu_section(gpu: Json) -> str:
    facts = gpu["facts"]
    rows = [
        [batch, *(number(rate) for rate in rates.values())]
        for batch, rates in facts["updates_per_second"].items()
    ]
    head = ("batch", f"updates a second: {facts['gpu']}", "one core")
    return "## The learner on a graphics processor\n\n" + table(head, rows)


FIGURES: dict[str, tuple[str, Callable[[Json], Figure]]] = {
    "ways": ("lidar", ways_figure),
    "growth": ("growth", growth_figure),
    "boats": ("environment", boats_figure),
}
SECTIONS: dict[str, Callable[[Json], str]] = {
    "lidar": scan_section,
    "oracle": oracle_section,
    "growth": growth_section,
    "environment": boats_section,
    "learner": learner_section,
    "gpu": gpu_section,
    "latency": latency_section,
    "start": start_section,
    "training": training_section,
}


def page(found: dict[str, Json]) -> Iterator[str]:
    yield "# Performance"
    yield (
        "What the parts cost, against what one would use instead. This page and its figures are written by"
        " `python benchmarks/page.py` from `benchmarks/results/`, where `make bench` leaves what it measures;"
        " `benchmarks/training.py`, which takes minutes, is run by hand."
    )
    yield bars_section(found)
    for name, section in SECTIONS.items():
        if name in found:
            yield section(found[name])
    yield machine_section(found)


def main() -> None:
    found = results()
    with house_style():
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
