"""Claims of the thesis: what we measured, and a verdict by a rule that is stated with the claim."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np

from dockctl.analysis.returns import break_even, format_unit
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    within_distance,
    within_heading,
)
from dockctl.geometry import Floats
from dockctl.runs.tables import RECENT
from studies.thesis.data import SELECTION, TEST, Archive, ArchivedRun, Facts
from studies.thesis.measures import Row, change_share, slowing_m
from studies.thesis.text import interquartile_mean, interval, middle, share, spread

Verdict = Literal["reproduced", "partly", "not reproduced", "better"]
Measured = tuple[str, Verdict]

SCENARIOS = ("s1", "s2", "s3")
POLICIES = {"s3": "scenario 3's policies", "marina": "the marina's policies"}
RELIABLE = 0.95
"""Success rate that counts as docking reliably; that of the stop rule."""


def claim_rows(facts: Facts, archive: Archive) -> list[Row]:
    """One row per claim: what the thesis states, the verdict, and our measurement."""
    rows = []
    for claim in facts.claims:
        text, verdict = MEASURES[claim.measure](facts, archive)
        rows.append(
            {
                "thesis": claim.claim,
                "where": claim.where,
                "verdict": f"**{verdict}**",
                "here": f"{text} ([more]({claim.page}))",
            }
        )
    return rows


def trained_starts(facts: Facts, archive: Archive) -> Measured:
    """Reproduced if every seed docks from its selection poses and reliably from the test starts nearby."""
    parts, reliable, docked = [], True, True
    for name in SCENARIOS:
        runs = archive[name]
        docked = docked and _all_dock(runs)
        rates = [_rate(run.outcomes(TEST)) for run in runs]
        reliable = reliable and min(rates) >= RELIABLE
        gaps = [float(gap.min()) for run in runs if len(gap := run.of_docked("clearance_m"))]
        parts.append(
            f"{name}: {share(sum(_all_dock([run]) for run in runs), len(runs))} seeds from the selection"
            f" poses, {spread([100 * rate for rate in rates], '{:.0f}', ' %')} of the test starts within 1 m"
            f" in x and y and 10°, minimum clearance by seed {spread(gaps, '{:.2f}', ' m')}"
        )
    return "; ".join(parts), _graded(docked and reliable, docked)


def five_poses(facts: Facts, archive: Archive) -> Measured:
    """At most partly reproduced: the five poses selected the checkpoints."""
    runs = archive["s2"]
    seeds = sum(_all_dock([run]) for run in runs)
    tests = [_rate(run.outcomes(TEST)) for run in runs]
    return (
        f"{share(seeds, len(runs))} seeds dock from all five, but these poses selected the checkpoint and"
        f" stopped the training; {spread([100 * rate for rate in tests], '{:.0f}', ' %')} of the test starts"
        " within 1 m in x and y and 10° of the initial poses dock",
        _graded(False, seeds > 0),
    )


def convergence(facts: Facts, archive: Archive) -> Measured:
    """Reproduced if every run of the thesis' learner docks in all of its last 100 episodes."""
    runs = [run for experiment in archive.group("thesis") for run in archive[experiment.name]]
    full = sum(run.recent_docked == RECENT for run in runs)
    ours = [run for name in SCENARIOS for run in archive[name]]
    mastered = share(sum(run.mastered for run in ours), len(ours))
    return (
        f"thesis' learner: {share(full, len(runs))} runs dock in all of their last {RECENT} episodes;"
        f" our learner: {mastered} runs reach 95 of 100",
        _graded(full == len(runs), full > 0),
    )


def early_collisions(facts: Facts, archive: Archive) -> Measured:
    """Reproduced if more than half of those episodes collide with δd in the unit used here."""
    parts, verdicts = [], []
    for unit, suffix in (("units of 20 m", ""), ("meters", "-meters")):
        shares = [collision_share(archive[f"thesis-{name}{suffix}"][0], facts) for name in ("s1", "s2")]
        parts.append(f"δd in {unit}: {spread([100 * value for value in shares], '{:.0f}', ' %')}")
        verdicts.append(min(shares) > 0.5)
    return "thesis' learner, scenarios 1 and 2, " + "; ".join(parts), _graded(verdicts[0], any(verdicts))


def collision_share(run: ArchivedRun, facts: Facts) -> float:
    """Share of collisions in the training episodes of which the thesis states that most collide."""
    first, last = facts.mostly_colliding
    rows = run.episodes[run.episodes["episode"].between(first, last)]
    return float((rows["outcome"] == "collision").mean())


def slowing(facts: Facts, archive: Archive) -> Measured:
    """Scenario 1: at least 8 m from the goal in the middle of the seeds; scenario 3: at most 5 m."""
    found = {name: [slowing_m(track) for run in archive[name] for track in run.tracks] for name in SCENARIOS}
    text = "; ".join(f"{name}: {spread(values, unit=' m')}" for name, values in found.items())
    early, late = _middle(found["s1"]) >= 8, _middle(found["s3"]) <= 5
    return f"distance to the goal when last at top speed: {text}", _graded(early and late, early or late)


def opposite_berth(facts: Facts, archive: Archive) -> Measured:
    return _berth("s3-opposite", archive)


def appendix_berth(facts: Facts, archive: Archive) -> Measured:
    return _berth("s3-appendix-b", archive)


def _berth(name: str, archive: Archive) -> Measured:
    """Reproduced if all of scenario 3's policies dock at an untrained berth, partly if some do."""
    counts = {who: seeds_docked(archive[who], name) for who in POLICIES}
    text = "; ".join(f"{POLICIES[who]}: {share(*found)} seeds" for who, found in counts.items())
    docked, seeds = counts["s3"]
    return text, _graded(docked == seeds, docked > 0)


def seeds_docked(runs: Sequence[ArchivedRun], scenario: str) -> tuple[int, int]:
    """Seeds that dock from every pose of another scenario, and all seeds."""
    return sum(_all_dock([run], scenario) for run in runs), len(runs)


def distance_from_start(facts: Facts, archive: Archive) -> Measured:
    """Reproduced if scenario 3's policies dock reliably within 3 m; partly if every success radius is 1 m."""
    parts = []
    for who, title in POLICIES.items():
        radii = ", ".join(format_radius(run.success_radius()) for run in archive[who])
        rates = {limit: [100 * _within(run, limit) for run in archive[who]] for limit in facts.fails_beyond_m}
        shares = ", ".join(f"{spread(found, '{:.0f}', ' %')} within {m:g} m" for m, found in rates.items())
        parts.append(f"{title}: {shares}, success radius by seed {radii}")
    reliable = min(_within(run, min(facts.fails_beyond_m)) for run in archive["s3"]) >= RELIABLE
    near = min(run.success_radius() or 0.0 for run in archive["s3"]) >= 1
    return "; ".join(parts), _graded(reliable, near)


def _within(run: ArchivedRun, limit_m: float) -> float:
    """Success rate of the free starts up to a distance, with small heading offsets."""
    free = within_distance(within_heading(free_starts(run.map), SMALL_OFFSET_DEG), limit_m)
    return float(free["docked"].mean())


def propeller_changes(facts: Facts, archive: Archive) -> Measured:
    """Reproduced if the changes at least halve, partly if the intervals are apart."""
    changes = {
        weight: [100 * change_share(t, "propeller_n") for run in archive[name] for t in run.tracks]
        for weight, name in (("20", "s3-velocity-20"), ("10", "s3"))
    }
    text = "; ".join(f"{weight}: {middle(values)} % of the steps" for weight, values in changes.items())
    high, low = (interval(_array(changes[weight])) for weight in ("20", "10"))
    halved = _middle(changes["10"]) <= 0.5 * _middle(changes["20"])
    return f"the propeller changes, with r_velocity {text}", _graded(halved, bool(low[1] < high[0]))


def intermediate_reward(facts: Facts, archive: Archive) -> Measured:
    """Reproduced if docking pays only above r_final in every unit of δd, partly if in one unit."""
    tables = [run.returns for run in archive["s3"]]
    final = float(archive["s3"][0].resolved["reward"]["terms"]["final"])
    parts, needed = [], []
    for unit in tables[0]["distance_unit_m"].unique():
        found = [break_even(table[table["distance_unit_m"] == unit]) for table in tables]
        least = [value for value in found if value is not None]
        above = f"above {spread(least, '{:,.0f}')}" if max(least) > 0 else "any"
        parts.append(f"δd in {format_unit(float(unit))}: {above}")
        needed.append(min(least) > final)
    text = "r_pre-final at which docking is worth more than loitering in front of the intermediate pose, "
    return text + "; ".join(parts), _graded(all(needed), any(needed))


def forward_pass(facts: Facts, archive: Archive) -> Measured:
    means = [float(run.latency_samples["forward_ms"].mean()) for run in archive["s3"]]
    text = f"{spread(means, '{:.2f}', ' ms')} on average, on another machine"
    return text, _faster(max(means), facts.forward_pass_ms)


def training_time(facts: Facts, archive: Archive) -> Measured:
    runs = [run for name in SCENARIOS for run in archive[name]]
    per_step = spread([run.milliseconds_per_step for run in runs], "{:.2f}", " ms")
    minutes = [run.minutes for run in runs]
    text = f"{per_step} per step, {spread(minutes, '{:.1f}', ' minutes')} per run, on another machine"
    return text, _faster(max(minutes) / 60, facts.hours_per_scenario)


MEASURES: dict[str, Callable[[Facts, Archive], Measured]] = {
    measure.__name__: measure
    for measure in (
        trained_starts, five_poses, convergence, early_collisions, slowing, opposite_berth, appendix_berth,
        distance_from_start, propeller_changes, intermediate_reward, forward_pass, training_time,
    )
}  # fmt: skip


def _all_dock(runs: Sequence[ArchivedRun], scenario: str = "") -> bool:
    return all(_rate(run.outcomes(SELECTION, scenario)) == 1 for run in runs)


def _rate(counts: dict[str, int] | None) -> float:
    return counts["docked"] / sum(counts.values()) if counts else 0.0


def _graded(whole: bool, part: bool) -> Verdict:
    if whole:
        return "reproduced"
    return "partly" if part else "not reproduced"


def _faster(ours: float, theirs: float) -> Verdict:
    return "better" if ours < theirs else "not reproduced"


def _array(values: Sequence[float]) -> Floats:
    return np.array(values, float)


def _middle(values: Sequence[float]) -> float:
    return float(interquartile_mean(_array(values)))
