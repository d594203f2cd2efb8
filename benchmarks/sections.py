"""The sections of docs/performance.md, from the results of the benchmarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import takewhile
from statistics import median

from figures import Json, number

CORES = (2, 8, 32, 128)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table; all columns but the first are right-aligned."""
    lines = [head, ["---", *("---:" for _ in head[1:])], *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


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


def cores_section(found: Json) -> str:
    facts, machine = found["facts"], found["hardware"]
    rows = []
    for point in facts["points"]:
        trained = "wall_s" in point
        rows.append(
            [
                f"{point['cores']}",
                *(f"{rate:,.0f}" for rate in point["stepping"]),
                f"{point['wall_s']:.0f}" if trained else "",
                f"{point['steps_per_second']:,.0f}" if trained else "",
                f"{point['cores_training']:.2f}" if trained else "",
            ]
        )
    boats = (f"steps per second, {boats:,} boats" for boats in facts["boats"])
    head = ("cores", *boats, "training [s]", "its steps per second", "cores in use")
    return f"""On 1 to {machine["cores"]} cores of another machine, {machine["processor"]}, with slower cores.
With 16 boats, a step takes as long as its slowest scan and its serial part; with more, steps per second grow
with the cores. A training of `s3` from the command to mastery gains little from more than two, because its
updates follow each other, each on one core. Its tables were the same bytes each time.

{table(head, rows)}"""


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
    return f"""## Start and short commands

Seconds until the first row of `updates.csv`, and of two commands until they end. The first start builds the
tables of every harbor and compiles the inner loops; both are cached. What limits them then is one thread of
Python: imports take 1.6 s of a start of `s3`, of which torch 0.8 s, 0.9 s of `evaluate` and 0.24 s of
`validate` (`python -X importtime`), which reads the twelve models of moored vessels in another 0.06 s.

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
            f"{ratio(row):.2f}" if docked else "",
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

    def ratio(row: Json) -> float:
        return float(row["policy_s"] / row["simulated_s"])

    direct = facts["direct"]
    docked = sum(row["policy_outcome"] == "docked" for row in direct)
    solved = [row for row in direct if "optimum_s" in row]
    ratios = sorted(ratio(row) for row in solved if row["policy_outcome"] == "docked")
    strengths = dict.fromkeys((row["wind_mps"], row["current_mps"]) for row in facts["storms"])
    storm_head = ("wind, current", "solved", "policy docks")
    kinds = dict.fromkeys((row["what"], row["direction_deg"]) for row in facts["weather"])
    missed = facts["missed"]
    steady = sum(row["policy_outcome"] == "docked" for row in missed)
    planned = sum("optimum_s" in row for row in missed if row["policy_outcome"] != "docked")
    rest = f"; of the others, a trajectory was found from {planned or 'none'}" if steady < len(missed) else ""
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

From {len(direct)} random test starts of `s3-direct`, within 1 m and 10° of this one, the policy docked
{docked} times, and a plan was found for {len(solved)}. The policy took {ratios[0]:.2f} to
{ratios[-1]:.2f} times as long as the executed plan, {median(ratios):.2f} times in the median.

The harbor is modeled by the convex outlines of what lies between keel and deck, from which the hull keeps
{1e2 * facts["clearance_m"]:.0f} cm at the end of each period; only outlines that the simulator found in the
way are added, and it tests every plan against the meshes.

The strongest constant wind and current for which a trajectory from the start of scenario 1 was found. The
steps are 1 m/s and 0.05 m/s; the weather is known to the plan and unknown to the policy, which was trained in
calm water. IPOPT is a local solver that was started from a few guesses: a time is an upper bound on the
minimum, and a failed search does not prove that no trajectory exists.

{table(weather_head, [weather_row(*kind) for kind in kinds])}

Both at once, each constant and from a random direction, from the same start; the policy is `marinas-weather`
with its planner.

{table(storm_head, [storm_row(*strength) for strength in strengths])}

In its weather `marinas-weather` with its planner does not dock from {len(missed)} of its 300 test starts. In
the mean wind and current of the failed episode, constant and without any other condition, it docks from
{steady} of them{rest}."""


SECTIONS: dict[str, Callable[[Json], str]] = {
    "lidar": scan_section,
    "reference": reference_section,
    "growth": growth_section,
    "environment": boats_section,
    "cores": cores_section,
    "learner": learner_section,
    "gpu": gpu_section,
    "latency": latency_section,
    "start": start_section,
    "training": training_section,
    "optimal_control": optimal_control_section,
}
