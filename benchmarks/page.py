"""Write docs/performance.md and its figures from the results of the benchmarks.

python benchmarks/page.py
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path
from textwrap import fill

from bench import BUSY, RESULTS
from figures import Json, boats_figure, docking_figure, growth_figure, number, scan_figure
from matplotlib.figure import Figure

from dockctl.reports.style import figure_style

CORES = (2, 8, 32, 128)
DOCS = Path(__file__).parents[1] / "docs"
SCRIPTS = (
    "lidar", "reference", "environment", "growth", "learner", "gpu", "latency", "start", "training",
    "optimal_control",
)  # fmt: skip


def results() -> dict[str, Json]:
    """Return the results of the scripts that have been run, by name."""
    paths = [RESULTS / f"{name}.json" for name in SCRIPTS]
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in paths if path.exists()}


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table; all columns but the first are right-aligned."""
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


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


def scan_section(lidar: Json) -> str:
    facts = lidar["facts"]
    return f"""## LiDAR scan

![time of a scan](figures/performance-scan.png)

The comparison is embree through trimesh, queried for distances only, with the sector ranges by numpy. The
tables of the fast scan need {number(facts["rays_mb"])} MB for the rays, shared by all harbors, and
{number(facts["harbor_mb"])} MB per harbor."""


def reference_section(reference: Json) -> str:
    facts = reference["facts"]
    return f"""The fast scan skips rays that cannot give a nearest return, and its results must equal those of
tracing every ray to the last bit: {facts["ranges_compared"]:,} ranges were compared, from
{facts["poses"]:,} poses in the whole basin, of which {facts["touching"]:,} are in contact with an obstacle or
inside one. Embree computes in single precision; its largest difference is
{number(facts["embree_off_mm"])} mm."""


def growth_section(growth: Json) -> str:
    facts = growth["facts"]
    rays, cuts, sectors = facts["rays"], facts["triangles"], facts["sectors"]
    by_rays, by_triangles, *_ = (f"{target['value']:.2f}" for target in growth["targets"])
    harbors = [
        [f"{one['harbors']}", number(1e6 * one["step"]["median"]), number(one["memory_mb"])]
        for one in facts["harbors"]
    ]

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
    return f"""## Scaling

![scaling](figures/performance-growth.png)

The time of a scan grows with the number of rays to the power of {by_rays}: a cell of a shell is looked up
once for all rays that cross it, and only rays that may give a nearest return are traversed. It grows with the
number of triangles to the power of {by_triangles}: the number of grid cells is constant, and a triangle is
tested only at its heights in a cell.

{table(("rays", *head), rows(rays, "rays"))}

{table(("triangles", *head), rows(cuts, "triangles"))}

More sectors mean more nearest returns to find, each of which ends the search in a narrower direction:

{table(("sectors", *head), rows(sectors, "sectors"))}

A scan from a pose of a training looks up 890 cells of the shells and traverses 2,100 of the 115,200 rays
through cells of 0.1 m; 80 of these hit something (means of 16,000 poses of scenario 3). On an Intel Xeon this
is bound by arithmetic rather than by memory: scans from the same 256 poses again and again are 9 % faster,
and tables in huge pages make no difference.

Harbors in one training: {facts["boats"]} boats of `marinas`, with its eight LiDARs, in that many generated
layouts. The memory is that of harbors, LiDAR tables and environment.

{table(("harbors", "CPU time per boat and step [µs]", "memory [MB]"), harbors)}"""


def boats_section(environment: Json) -> str:
    facts = environment["facts"]
    timed = zip(facts["boats"], environment["seconds"].values(), facts["processor_seconds"], strict=True)
    rows = [
        [f"{boats:,}", f"{1 / wall['median']:,.0f}", number(1e6 * processor["median"]), number(held / 1e6)]
        for (boats, wall, processor), held in zip(timed, facts["held_bytes"], strict=True)
    ]
    processor, serial = (
        [seconds["median"] for seconds in facts[key]] for key in ("processor_seconds", "serial_seconds")
    )
    implied = [
        [
            f"{boats:,}",
            number(1e6 * own),
            f"{own / total:.0%}",
            *(f"{1 / (own + (total - own) / cores):,.0f}" for cores in CORES),
        ]
        for boats, total, own in zip(facts["boats"], processor, serial, strict=True)
    ]
    return f"""## Batched environments

![boats](figures/performance-boats.png)

{table(("boats", "steps per second", "CPU time per boat and step [µs]", "memory [MB]"), rows)}

A step of one boat through `gymnasium.make` takes {number(facts["one_step_ms"]["median"])} ms (median) and
{number(facts["one_step_ms"]["p99"])} ms (99th percentile). At small batch sizes, Python call overhead and
waiting for the slowest scan dominate; at large ones, the scan dominates. Memory grows by
{number(facts["held_bytes_a_boat"] / 1e3)} kB per boat, of which the state is
{number(facts["state_bytes_a_boat"] / 1e3)} kB; the rest is the random generator and the last observation and
info.

Scans run on all cores, everything else in one thread. From the CPU time of a step without a LiDAR, the serial
part, follows how many steps per second other numbers of cores would make (Amdahl's law); the machine has
{facts["cores"]}:

{table(("boats", "serial [µs]", "share", *(f"{cores} cores" for cores in CORES)), implied)}"""


def latency_section(latency: Json) -> str:
    facts = latency["facts"]
    rows = [
        [part.removesuffix("_ms").replace("_", " "), number(times["p50"]), number(times["p99"])]
        for part, times in facts["milliseconds"].items()
    ]
    return f"""## Latency

One boat, one core, {facts["decisions"]:,} decisions along greedy episodes [ms]:

{table(("part", "median", "99th percentile"), rows)}

The scan dominates a decision."""


def learner_section(learner: Json) -> str:
    batches = {name: facts for name, facts in learner["facts"].items() if "updates_per_second" in facts}
    tables = [
        table(
            (name, "updates per second", "speed of dockctl relative to it"),
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
            "## Learner",
            "One core. Relative to the rate at which this core multiplies large matrices, an update reaches"
            f" {' and '.join(shares)}.",
            *tables,
        ]
    )


def start_section(start: Json) -> str:
    rows = [
        [case, *(number(seconds[of]) for of in ("min", "median", "max"))]
        for case, seconds in start["seconds"].items()
    ]
    return f"""## Time to the first gradient step

Seconds until the first row of `updates.csv`. The first start builds the tables of every harbor and compiles
the inner loops; both are cached:

{table(("", "min", "median", "max"), rows)}"""


def training_section(training: Json) -> str:
    rows = [
        [
            f"{run['scenario']}, seed {run['seed']}",
            f"{run['wall_s']:.0f}",
            f"{run['env_steps']:,}",
            f"{run['validation']:.0%}",
            f"{run['cores_used']:.2f}",
            f"{run['cores_training']:.2f}",
            number(run["steps_per_second"]) if run["steps_per_second"] else "",
            f"{run['peak_memory_gb']:.2f}",
        ]
        for run in training["facts"]["runs"]
    ]
    head = (
        "training", "seconds", "steps", "docked", "cores, command", "cores, training", "steps per second",
        "peak memory [GB]",
    )  # fmt: skip
    return f"""## Training until mastery

From the command to mastery: in scenarios 1 to 3 the stop rule ends the training, in the marina the first
validation does that docks from 99 of 100 starts. "Docked" is the share of the last validation's starts. Steps
per second are those from 20,000 to 90,000 steps, with the evaluations every 10,000 steps. Cores in use are
those of the whole command, which starts in one thread, and those of the training from 10,000 steps to its
end, with evaluations and validations.

{table(head, rows)}"""


def machine_section(found: dict[str, Json]) -> str:
    rows = [
        [
            f"`benchmarks/{name}.py`",
            result["when"].replace("T", " ").removesuffix("+00:00"),
            f"`{result['commit'][:7]}`" if result["commit"] else "",
            f"{result['load']:.1f}" + (" (busy)" if result["load"] > BUSY else ""),
        ]
        for name, result in found.items()
    ]
    missing = ", ".join(f"`benchmarks/{name}.py`" for name in SCRIPTS if name not in found)
    others = (result for name, result in found.items() if name != "gpu")  # measured on another machine
    in_order = sorted(others, key=lambda result: result["when"])
    latest, versions = in_order[-1], {}
    for result in in_order:  # a script needs only some of them
        versions |= result["libraries"]
    libraries = ", ".join(f"{name} {version}" for name, version in versions.items())
    machine = latest["hardware"]
    return f"""## Machine and method

{machine["processor"]}, {machine["cores"]} cores, {machine["platform"]}; Python {latest["python"]};
{libraries}.

{table(("script", "time (UTC)", "commit", "cores used by other processes"), rows)}

Work on one core is measured in CPU time, which other processes affect little; work on several cores in
wall-clock time, which is unreliable on a busy machine. The compared variants alternate, and a ratio is the
median of the ratios of the rounds.{f" Without results: {missing}." if missing else ""}"""


def gpu_section(gpu: Json) -> str:
    facts = gpu["facts"]
    tables = [
        table(
            (what, "GPU", "all cores" if what.startswith("environment") else "one core"),
            [[case, number(rates["cuda"]), number(rates["cpu"])] for case, rates in facts[what].items()],
        )
        for what in ("environment steps per second", "updates per second")
        if what in facts
    ]
    machine = gpu["hardware"]
    where = f"""On a machine of its own: {facts["gpu"]}, {machine["processor"]}, {machine["cores"]} cores,
with torch {gpu["libraries"]["torch"]}. Each row of updates is a size of the batch."""
    return "\n\n".join(["## On a GPU", where, *tables])


def optimal_control_section(optimal: Json) -> str:
    facts = optimal["facts"]

    def policy(row: Json) -> str:
        return f"{row['policy_s']:.1f}" if row["policy_outcome"] == "docked" else row["policy_outcome"]

    def calm_row(row: Json) -> list[str]:
        x, y, heading = row["start"]
        docked = "optimum_s" in row and row["policy_outcome"] == "docked"
        return [
            f"`{row['scenario']}` ({x:g}, {y:g}, {heading:g}°)",
            f"{row['optimum_s']:.1f}" if "optimum_s" in row else "not found",
            f"{row['simulated_s']:.1f}" if "simulated_s" in row else "",
            policy(row),
            f"{row['policy_s'] / row['simulated_s']:.2f}" if docked else "",
        ]

    def weather_row(what: str, direction: int) -> list[str]:
        rows = [row for row in facts["weather"] if (row["what"], row["direction_deg"]) == (what, direction)]
        found = [row for row in rows if "optimum_s" in row]
        missed = [row for row in rows if "optimum_s" not in row]
        docked = [*takewhile(lambda row: row["policy_outcome"] == "docked", rows)]
        return [
            f"{what}, toward {direction}°",
            f"{found[-1]['speed_mps']:g} m/s" if found else "none",
            f"{found[-1]['simulated_s']:.1f}" if found else "",
            f"{missed[0]['speed_mps']:g} m/s" if missed else "",
            f"{docked[-1]['speed_mps']:g} m/s" if docked else "none",
        ]

    def storm_row(wind: float, current: float) -> list[str]:
        rows = [row for row in facts["storms"] if (row["wind_mps"], row["current_mps"]) == (wind, current)]
        return [
            f"{wind:g} m/s, {current:g} m/s",
            f"{sum('optimum_s' in row for row in rows)} of {len(rows)}",
            f"{sum(row['policy_outcome'] == 'docked' for row in rows)} of {len(rows)}",
        ]

    strengths = dict.fromkeys((row["wind_mps"], row["current_mps"]) for row in facts["storms"])
    storm_head = ("wind, current", "solved", "policy docks")
    kinds = dict.fromkeys((row["what"], row["direction_deg"]) for row in facts["weather"])
    missed = facts["missed"]
    steady = sum(row["policy_outcome"] == "docked" for row in missed)
    planned = sum("optimum_s" in row for row in missed if row["policy_outcome"] != "docked")
    calm_head = ("start", "optimum [s]", "executed [s]", "policy [s]", "ratio")
    weather_head = ("s1 in", "strongest solved", "time [s]", "weakest unsolved", "policy docks up to")
    return f"""## Optimal control

![optimal and learned trajectories](figures/performance-docking.png)

The minimum time of docking with full knowledge of harbor, wind and current, by CasADi and IPOPT, next to the
shipped policies, one greedy episode from each start. The equations of motion, the wind forces and the
tolerances are those of dockctl. "Executed" is the plan in whole control periods of 0.5 s, as the simulator
followed it until the boat docked, without contact; the ratio is the time of the policy relative to it.
Commands of a plan are continuous, those of a policy a grid of 77. Scenario 2 has five rows, the test poses of
its table; `s3-direct`, in the figure "direct", has no intermediate pose.

{table(calm_head, [calm_row(row) for row in facts["calm"]])}

The harbor is modeled by the convex outlines of what lies between keel and deck, from which the hull keeps
{1e2 * facts["clearance_m"]:.0f} cm at the end of each period; only outlines that the simulator found in the
way are added, and it tests every plan against the meshes.

The strongest constant wind and current for which a trajectory from the start of scenario 1 was found. The
steps are 1 m/s and 0.05 m/s; the weather is known to the plan and unknown to the policy, which was trained in
calm water. IPOPT is a local solver that was started from a few guesses: a time is an upper bound on the
minimum, and a failed search does not prove that no trajectory exists.

{table(weather_head, [weather_row(*kind) for kind in kinds])}

Both at once, each constant and from a random direction, from the same start; the policy is `marinas-weather`.

{table(storm_head, [storm_row(*strength) for strength in strengths])}

In weather, `marinas-weather` does not dock from {len(missed)} of its 300 test starts. In the mean wind and
current of the failed episode, constant and without any other condition, it docks from {steady} of them. From
{planned} of the others a trajectory was found, with the weather known."""


FIGURES: dict[str, tuple[str, Callable[[Json], Figure]]] = {
    "scan": ("lidar", scan_figure),
    "growth": ("growth", growth_figure),
    "boats": ("environment", boats_figure),
    "docking": ("optimal_control", docking_figure),
}
SECTIONS: dict[str, Callable[[Json], str]] = {
    "lidar": scan_section,
    "reference": reference_section,
    "growth": growth_section,
    "environment": boats_section,
    "learner": learner_section,
    "gpu": gpu_section,
    "latency": latency_section,
    "start": start_section,
    "training": training_section,
    "optimal_control": optimal_control_section,
}


def page(found: dict[str, Json]) -> Iterator[str]:
    yield "# Performance"
    yield (
        "Time and memory, compared with other libraries, and docking times, compared with optimal control."
        " `make bench` measures into `benchmarks/results/`,"
        " and `python benchmarks/page.py` writes this page and its figures from there;"
        " `benchmarks/training.py` and `benchmarks/optimal_control.py`, which take minutes, and"
        " `benchmarks/gpu.py`, which needs a GPU, are run separately."
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
