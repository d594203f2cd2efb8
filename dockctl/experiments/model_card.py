"""The card of a shipped policy, written from its run folder: what it is, what it does, and where it fails."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from dockctl.agents.checkpoint import PolicyCard
from dockctl.analysis.episodes import ending
from dockctl.analysis.statistics import wilson_interval
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.errors import DockctlError
from dockctl.runs.directory import PROVENANCE, RunDirectory
from dockctl.runs.tables import START_KINDS
from dockctl.scenarios.schema import ObservationPart, Scenario

FAILURES_LISTED = 12
SORTS = {"training": "poses of its training", **START_KINDS}
EPISODES = ("start_kind", "x_m", "y_m", "heading_deg", "outcome", "collided_with", "phase", "clearance_m")
CELLS = ("dx_m", "dy_m", "dheading_deg", "blocked", "outcome", "collided_with")
"""Columns that the card is written from."""
LIMITS = """\
For research and teaching in simulation. It was trained for one vessel, without wind, current, waves, moving
vessels or sensor noise, and knows its own pose and velocity exactly. It promises nothing for a real boat,
which would need training with all of that, and someone at the helm."""
FIXED = """\
It knows one berth, and the starts of its training; what it does from elsewhere is what the tables say."""
BERTHS = """\
It was trained at some berths of one marina, with the vessels of one fleet moored in the others."""


def table(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """Read episodes that ``dockctl evaluate`` or ``dockctl map`` wrote.

    Raises:
        DockctlError: the file cannot be read, or has not the columns.
    """
    try:
        read = pd.read_csv(path, keep_default_na=False, na_values=[""], dtype={"collided_with": str})
    except (OSError, ValueError) as error:
        raise DockctlError(f"{path}: cannot be read: {error}") from None
    if missing := [column for column in columns if column not in read]:
        raise DockctlError(f"{path}: has no column {', '.join(missing)}; evaluate the run again")
    return read.assign(collided_with=read["collided_with"].fillna(""))


def is_of(card: PolicyCard, run: RunDirectory, name: str) -> bool:
    """Whether the JSON file `name` of the run is there and tells that this very policy was measured.

    Raises:
        DockctlError: it cannot be read.
    """
    if not (run.path / name).is_file():
        return False
    return bool(run.read_json(name).get("policy", {}).get("sha256") == card.sha256)


def evaluations(run: RunDirectory, card: PolicyCard) -> dict[str, pd.DataFrame]:
    """Read the evaluations of a run's policy by the stems of their files, that on its own scenario first.

    Raises:
        DockctlError: one cannot be read.
    """
    paths = [run.path / "evaluation.csv", *sorted(run.path.glob("evaluation-*.csv"))]
    return {path.stem: table(path, EPISODES) for path in paths if is_of(card, run, f"{path.stem}.json")}


def write(
    name: str,
    scenario: Scenario,
    card: PolicyCard,
    run: RunDirectory,
    others: Sequence[tuple[int, Mapping[str, float]]],
    training: pd.DataFrame,
    folder: Path,
    files: Sequence[Path],
) -> str:
    """Return the text of the card.

    Args:
        name: of the checkpoint.
        others: seed and docked share by sort of start of every run that it was chosen from, by rank.
        training: its episodes from the poses of its training, columns `EPISODES`.
        folder, files: the checkpoint's folder and the files in it, for their hashes.
    """
    episodes = {"": training, **evaluations(run, card)}
    sections = [
        f"# {name}\n\n{scenario.title}\n\n{scenario.description}".rstrip(),
        "```sh\n" + f"dockctl evaluate --ckpt {name}\n" + "```",
        "## What it is\n\n" + _rows(("", ""), _facts(scenario, card, run, others)),
        "## What it does\n\nEpisodes of the greedy policy, and the Wilson interval of their success:\n\n"
        + _rows(
            ("scenario", "starts", "docked", "success", "95 % interval", "least clearance"),
            _successes(scenario, episodes),
        ),
        *_further(run, card),
        "## Known failures\n\n" + "\n".join(_failures(scenario, episodes)),
        "## Use and limits\n\n" + LIMITS + "\n" + (FIXED if scenario.task.berths is None else BERTHS),
        "## Files\n\n" + _rows(("file", "SHA-256"), _hashes(folder, files)),
    ]
    return "\n\n".join(sections) + "\n"


def _facts(
    scenario: Scenario, card: PolicyCard, run: RunDirectory, others: Sequence[tuple[int, Mapping[str, float]]]
) -> Iterator[tuple[str, str]]:
    facts = run.read_json(PROVENANCE)
    yield "scenario", f"`{card.scenario}`, in full in `scenario.yaml`"
    yield "seed", f"{card.seed}"
    if len(others) > 1:
        kind = list(others[0][1])[-1]
        rates = ", ".join(f"{_rate(share, kind)} (seed {seed})" for seed, share in others)
        yield (
            "chosen",
            f"of {len(others)} runs, for its evaluations, which therefore flatter it;"
            f" {START_KINDS.get(kind, kind)} docked: {rates}",
        )
    yield "steps", f"{card.env_steps:,} environment steps, where its training found the best greedy policy"
    yield "network", f"dueling, layers of {', '.join(map(str, card.hidden_sizes))}"
    sectors = scenario.sensors.lidar.sectors
    parts = ", ".join(map(_part, scenario.observation))
    yield "observes", f"{card.observation_size} numbers: {parts}; {sectors} LiDAR sectors"
    yield "acts", f"{scenario.actions.describe()}, every {scenario.vessel.control_period_s:g} s"
    yield (
        "made by",
        f"dockctl {facts.get('dockctl')}, commit `{facts.get('git_commit')}`, {facts.get('started')}",
    )
    yield "learned from", "simulated episodes of its own; no recorded data"


def _rate(share: Mapping[str, float], kind: str) -> str:
    return f"{share[kind]:.0%}" if kind in share else "-"


def _part(given: ObservationPart) -> str:
    values = ", ".join(f"{key}={value}" for key, value in given.params.items())
    return f"`{given.part}({values})`" if values else f"`{given.part}`"


def _successes(scenario: Scenario, evaluations: Mapping[str, pd.DataFrame]) -> Iterator[tuple[str, ...]]:
    for where, kind, part in _groups(scenario, evaluations):
        docked, n = int((part["outcome"] == "docked").sum()), len(part)
        low, high = wilson_interval(docked, n)
        least = f"{part['clearance_m'].min():.2f} m"
        yield f"`{where}`", kind, f"{docked} of {n:,}", f"{docked / n:.1%}", f"{low:.1%} to {high:.1%}", least


def _groups(
    scenario: Scenario, evaluations: Mapping[str, pd.DataFrame]
) -> Iterator[tuple[str, str, pd.DataFrame]]:
    for stem, episodes in evaluations.items():
        where = stem.removeprefix("evaluation").removeprefix("-")
        where = f"another {where}" if where == scenario.name else where or scenario.name
        for kind in episodes["start_kind"].unique():
            yield where, SORTS.get(kind, kind), episodes[episodes["start_kind"] == kind]


def _further(run: RunDirectory, card: PolicyCard) -> Iterator[str]:
    """What the map of starts and the timing of decisions tell, where the run has them of this policy."""
    if is_of(card, run, "map.json"):
        starts = table(run.path / "map.csv", CELLS)
        free, reach = free_starts(starts), half_width(starts)
        straight, askew = (
            format_radius(success_radius(within_heading(free, limit), reach))
            for limit in (0, SMALL_OFFSET_DEG)
        )
        yield (
            f"Of {len(free):,} free starts within ±{reach:g} m of the first initial pose, at any of the"
            f" headings tried, {free['docked'].mean():.0%} dock. The radius within which every free start"
            f" docks is {straight} with the heading of the pose, and {askew} up to 20° askew."
        )
    if is_of(card, run, "figures/latency.json"):
        timing = run.read_json("figures/latency.json")
        times: dict[str, Any] = timing.get("milliseconds", {})
        forward, whole = times.get("Forward pass"), times.get("Whole decision")
        if forward and whole:
            yield (
                f"A decision takes {whole['p50']:.2g} ms at the median and {whole['max']:.2g} ms at most, its"
                f" forward pass {forward['p50']:.2g} ms, of a control period of"
                f" {timing['control_period_ms']:g} ms ({timing['hardware']['processor']}, one core)."
            )


def _failures(scenario: Scenario, evaluations: Mapping[str, pd.DataFrame]) -> Iterator[str]:
    """The endings that are no docking, and where the first of them began."""
    any_failed = False
    for where, kind, part in _groups(scenario, evaluations):
        failed = part[part["outcome"] != "docked"]
        if failed.empty:
            continue
        any_failed = True
        endings = Counter(ending(row.to_dict()) for _, row in failed.iterrows())
        told = ", ".join(f"{count} {ending}" for ending, count in endings.most_common())
        yield f"- `{where}`, {kind}: {len(failed)} of {len(part):,} failed: {told}."
        places = [f"({row.x_m:.2f}, {row.y_m:.2f}, {row.heading_deg:.0f}°)" for row in failed.itertuples()]
        more = f" and {len(places) - FAILURES_LISTED} more" if len(places) > FAILURES_LISTED else ""
        yield f"  From x m, y m, heading: {', '.join(places[:FAILURES_LISTED])}{more}."
    if not any_failed:
        yield "None in the episodes above."


def _hashes(folder: Path, files: Sequence[Path]) -> Iterator[tuple[str, str]]:
    for file in files:
        digest = hashlib.sha256(file.read_bytes()).hexdigest()
        yield f"`{file.relative_to(folder).as_posix()}`", f"`{digest}`"


def _rows(head: Sequence[str], rows: Iterator[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
