"""The thesis' claims, each with what we measured of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from dockctl.analysis.latency import THESIS_FORWARD_MS
from dockctl.analysis.returns import break_even, unit_words
from dockctl.analysis.success_map import SMALL_OFFSET_DEG, format_radius, free_starts, within_heading
from dockctl.reports.success_map import THESIS_M
from studies.thesis.elsewhere import MARINA, WHOSE
from studies.thesis.kept import Kept, Kepts
from studies.thesis.markdown import NOT_RUN, share, spread
from studies.thesis.measures import change_share, slowing_m
from studies.thesis.page import middle, seeds_docked
from studies.thesis.thesis import HOURS_A_SCENARIO, SECONDS_A_STEP
from studies.thesis.time import milliseconds_a_step

SCENARIOS = ("s1", "s2", "s3")


@dataclass(frozen=True)
class Claim:
    """Something that the thesis says, where, and how we measure it."""

    says: str
    where: str
    measured: Callable[[Kepts], str]
    page: str

    def row(self, kept: Kepts) -> dict[str, str]:
        found = self.measured(kept)
        return {"the thesis": self.says, "where": self.where, "here": f"{found} ([more]({self.page}))"}


def docks(kept: Kepts) -> str:
    """Seeds that dock from every test pose, and the closest that they came to anything."""
    return "; ".join(_docks(name, kept[name]) for name in SCENARIOS)


def _docks(name: str, runs: Sequence[Kept]) -> str:
    if not runs:
        return f"{name} {NOT_RUN}"
    all_dock = [ended for run in runs if (ended := run.ended("pose")) is not None]
    clearance = [float(gap.min()) for run in runs if len(gap := run.of_docked("clearance_m"))]
    every = sum(docked == count for docked, count in all_dock)
    return (
        f"{name}: {every} of {len(runs)} seeds, least clearance by seed {spread(clearance, '{:.2f}', ' m')}"
    )


def slows(kept: Kepts) -> str:
    """Where the boat makes top speed for the last time."""
    found = {name: [slowing_m(t) for run in kept[name] for t in run.tracks] for name in SCENARIOS}
    return "last at top speed " + "; ".join(
        f"{name}: {spread(values, unit=' m off')}" for name, values in found.items()
    )


def five_poses(kept: Kepts) -> str:
    """Test poses docked by every seed."""
    ended = [(run.seed, found) for run in kept["s2"] if (found := run.ended("pose"))]
    return "; ".join(f"seed {seed}: {share(found)}" for seed, found in ended) or NOT_RUN


def other_berth(name: str) -> Callable[[Kepts], str]:
    """Seeds that dock at an untrained berth."""

    def measured(kept: Kepts) -> str:
        parts = []
        for who, words in WHOSE.items():
            counts = seeds_docked(kept[who], name)
            parts.append(f"{words}: {share(counts)}{' seeds' if counts else ''}")
        return "; ".join(parts)

    return measured


def radius(kept: Kepts) -> str:
    """Success radius, and success within the thesis' distances."""
    parts = []
    for who, words in WHOSE.items():
        mapped = [run for run in kept[who] if run.map is not None]
        if not mapped:
            parts.append(f"{words}: {NOT_RUN}")
            continue
        radii = ", ".join(format_radius(run.radius()) for run in mapped)
        shares = "; ".join(
            f"{spread([100 * _within(run, limit) for run in mapped], '{:.0f}', ' %')} within {limit:g} m"
            for limit in THESIS_M
        )
        parts.append(f"{words}: success radius {radii} by seed; {shares}")
    return "; ".join(parts)


def _within(run: Kept, limit_m: float) -> float:
    assert run.map is not None  # the caller has asked
    free = within_heading(free_starts(run.map), SMALL_OFFSET_DEG)
    return float(free.loc[free["offset_m"] <= limit_m + 1e-6, "docked"].mean())


def halved(kept: Kepts) -> str:
    """Share of the steps in which the propeller's command changes, for both weights."""
    parts = []
    for weight, name in (("20", "s3-velocity-20"), ("10", "s3")):
        tracks = [track for run in kept[name] for track in run.tracks]
        changes = [100 * change_share(track, "propeller_n") for track in tracks]
        parts.append(f"{weight}: {middle(changes) + ' % of the steps' if changes else NOT_RUN}")
    return "the propeller changes, with r_velocity " + "; ".join(parts)


def gate(kept: Kepts) -> str:
    """What the intermediate pose must pay for docking to be worth more than loitering in front of it."""
    judged = [run.returns for run in kept["s3"] if run.returns is not None]
    if not judged:
        return NOT_RUN
    parts = []
    for unit in judged[0]["distance_unit_m"].unique():
        found = [break_even(table[table["distance_unit_m"] == unit]) for table in judged]
        least = [value for value in found if value is not None]
        needed = f"above {spread(least, '{:,.0f}')}" if max(least, default=0) > 0 else "always"
        parts.append(f"δd in {unit_words(float(unit))}: {needed}")
    return "docking is worth more than loitering at the gate for an r_pre-final, " + "; ".join(parts)


def forward(kept: Kepts) -> str:
    """Mean duration of the forward pass."""
    means = [float(run.samples["forward_ms"].mean()) for run in kept["s3"] if run.samples is not None]
    return f"{spread(means, '{:.2f}', ' ms')} on average" if means else NOT_RUN


def time(kept: Kepts) -> str:
    """Wall time of a step and of a training."""
    runs = [run for name in SCENARIOS for run in kept[name]]
    if not runs:
        return NOT_RUN
    each = spread([milliseconds_a_step(run) for run in runs], "{:.2f}", " ms")
    return f"{each} a step, {spread([run.minutes for run in runs], '{:.1f}', ' minutes')} a training"


def held_out(kept: Kepts) -> str:
    """Beyond the thesis: success at berths of no training."""
    ended = [(run.seed, found) for run in kept[MARINA] if (found := run.ended("held_out"))]
    return "; ".join(f"seed {seed}: {share(found)}" for seed, found in ended) or NOT_RUN


_RADII = " or ".join(f"{radius:g} m" for radius in THESIS_M)
CLAIMS = (
    Claim("docks safely from where it was trained", "§§4.1.1, 4.2.1, 4.3.1", docks, "results/scenario-1.md"),
    Claim(
        "slows down gradually, in scenario 1 from 10 m off; late in scenario 3", "§§4.1.1, 4.2.1, 4.3.1",
        slows, "results/scenario-1.md#maneuver",
    ),
    Claim("docks from the five poses of Table 4.3", "§4.2.1", five_poses, "results/scenario-2.md"),
    Claim(
        "docks at the berth on the other side", "§4.3.2", other_berth("s3-opposite"),
        "results/generalization.md#the-berth-on-the-other-side",
    ),
    Claim(
        "docks at one more berth", "§4.3.2, app. B", other_berth("s3-appendix-b"),
        "results/generalization.md#the-berth-of-appendix-b",
    ),
    Claim(
        f"docks from within {_RADII} of the trained start, not beyond", "§§4.4, 5.2", radius,
        "results/generalization.md#how-far-from-the-trained-start",
    ),
    Claim(
        "halving r_velocity all but ends sudden changes of the propeller", "§4.3.1", halved,
        "results/reward.md#r_velocity-20-or-10",
    ),
    Claim("the intermediate pose pays a very high reward", "§4.3", gate, "results/reward.md"),
    Claim(f"a forward pass takes {THESIS_FORWARD_MS:g} ms", "§4.3.3", forward, "results/time.md"),
    Claim(
        f"{SECONDS_A_STEP:g} s a step, {HOURS_A_SCENARIO:g} h a scenario", "§4.3.3", time,
        "results/time.md#a-training",
    ),
    Claim("(not in the thesis) docks at berths held out of the training", "", held_out, "results/marina.md"),
)  # fmt: skip


def rows(kept: Kepts) -> Iterator[dict[str, str]]:
    """The table of claims."""
    return (claim.row(kept) for claim in CLAIMS)
