"""Model card of an exported policy: what it is, how well it docks, and where it fails."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, StrictUndefined

import dockctl
from dockctl.agents.algorithms import algorithm_of
from dockctl.agents.checkpoint import PolicyCard
from dockctl.analysis.episodes import count_by_kind, describe_outcome
from dockctl.analysis.statistics import describe_share
from dockctl.analysis.success_map import (
    SMALL_OFFSET_DEG,
    format_radius,
    free_starts,
    half_width,
    success_radius,
    within_heading,
)
from dockctl.errors import DockctlError
from dockctl.geometry import pose_label
from dockctl.reading import reading
from dockctl.run_files import ENVELOPE, EVALUATION, FIGURES, LATENCY, MAP, PROVENANCE
from dockctl.runs.directory import RunDirectory
from dockctl.runs.provenance import git_commit
from dockctl.runs.reader import read_table
from dockctl.runs.results import policy_hash, read_results
from dockctl.runs.tables import ENVELOPE as ENVELOPE_COLUMNS
from dockctl.runs.tables import START_KINDS
from dockctl.scenarios.schema import HELPERS, ObservationPart, Scenario

TEMPLATE = Path(__file__).with_name("card.md.j2")
LISTED_FAILURES = 12
OWN_KINDS = {**START_KINDS, "training": "training poses"}
"""Kinds of starts in the scenario that the policy was trained on."""
EPISODES = ("start_kind", "x_m", "y_m", "heading_deg", "outcome", "collided_with", "phase", "clearance_m")
"""Columns of an evaluation that the card needs."""
CELLS = ("dx_m", "dy_m", "dheading_deg", "blocked", "outcome", "collided_with")
"""Columns of a success map that the card needs."""

Candidates = Sequence[tuple[int, Mapping[str, float]]]


def card_text(
    name: str,
    scenario: Scenario,
    card: PolicyCard,
    run: RunDirectory,
    candidates: Candidates,
    training: pd.DataFrame,
    files: Mapping[str, Path],
) -> str:
    """Return the card as Markdown.

    Args:
        name: of the checkpoint.
        candidates: seed and success rate by kind of start of each run that it was selected from, best first.
        training: greedy episodes from the training poses, columns `EPISODES`.
        files: of the checkpoint, by path in its folder.
    """
    groups = list(_groups(scenario, {"": training, **read_evaluations(run, card)}))
    environment = Environment(
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    text = environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        name=name,
        scenario=scenario,
        facts=list(_facts(scenario, card, run, candidates)),
        helpers=[name for name in HELPERS if getattr(scenario.evaluation, name)],
        successes=list(_successes(groups)),
        map=_map(run, card),
        envelope=_envelope(run, card),
        latency=_latency(run, card),
        failures=list(_failures(groups)),
        hashes=[
            (f"`{path}`", f"`{hashlib.sha256(file.read_bytes()).hexdigest()}`")
            for path, file in files.items()
        ],
    )
    return text.rstrip() + "\n"


def read_evaluations(run: RunDirectory, card: PolicyCard) -> dict[str, pd.DataFrame]:
    """Read the evaluations of a run's policy by file name without suffix, first that in its own scenario.

    Raises:
        DockctlError: a file cannot be read.
    """
    paths = [run.path / f"{EVALUATION}.csv", *sorted(run.path.glob(f"{EVALUATION}-*.csv"))]
    return {path.stem: _read(path, EPISODES) for path in paths if is_of_policy(card, run, path.stem)}


def is_of_policy(card: PolicyCard, run: RunDirectory, measurement: str) -> bool:
    """Return whether the run has this measurement, a name in `dockctl.run_files`, of this policy.

    Raises:
        DockctlError: one of its files cannot be read, or its table is from a different measurement.
    """
    path = run.path / f"{measurement}.json"
    return path.is_file() and policy_hash(read_results(path)) == card.sha256


def _read(path: Path, columns: Sequence[str]) -> pd.DataFrame:
    """Read a table of ``dockctl evaluate`` or ``dockctl map``.

    Raises:
        DockctlError: the file cannot be read, or lacks a column.
    """
    table = read_table(path, columns)
    if table is None:
        raise DockctlError(f"{path}: is missing or empty; measure the policy again", code="not_found")
    return table.assign(collided_with=table["collided_with"].astype(object).fillna(""))


def _facts(
    scenario: Scenario, card: PolicyCard, run: RunDirectory, candidates: Candidates
) -> Iterator[tuple[str, str]]:
    provenance = run.read_json(PROVENANCE)
    yield "scenario", f"`{card.scenario}`, in full in `scenario.yaml`"
    yield "seed", f"{card.seed}"
    if len(candidates) > 1:
        kind = list(candidates[0][1])[-1]
        rates = ", ".join(f"{_rate(shares, kind)} (seed {seed})" for seed, shares in candidates)
        yield (
            "selected",
            f"best of {len(candidates)} runs by these evaluations, so its success rates are biased upward;"
            f" {OWN_KINDS.get(kind, kind)} docked: {rates}",
        )
    yield "steps", f"{card.env_steps:,} environment steps, at the best greedy evaluation during training"
    learner = algorithm_of(scenario.training).describe()
    layers = f"{learner}, layers of {', '.join(map(str, card.hidden_sizes))}"
    if ensemble := scenario.training.ensemble:
        layers += f"; an ensemble of {ensemble.networks}, {ensemble.every_steps:,} steps apart"
        if ensemble.restarts:
            layers += f", from each of {scenario.training.parts} parts of the training"
        layers += ", and of their mirror images" if scenario.training.mirrored else ""
    if hysteresis := scenario.training.hysteresis:
        layers += f"; it keeps its last action until another one is better by {hysteresis:g}"
    yield "network", layers
    if scenario.evaluation.supervisor:
        yield (
            "supervisor",
            "replaces actions that lead to contact, makes a waiting boat move, and knows the map",
        )
    if scenario.evaluation.planner:
        does = "plans the last meters and replaces actions that lead to contact"
        yield "planner", f"{does}, with the map, wind and current"
    sectors = scenario.sensors.lidar.sectors
    parts = ", ".join(map(_part, scenario.observation))
    yield "observation", f"{card.observation_size} numbers: {parts}; {sectors} LiDAR sectors"
    yield "actions", f"{scenario.actions.describe()}, every {scenario.vessel.control_period_s:g} s"
    if initial := provenance.get("initial"):
        yield "fine-tuned from", f"`{initial['scenario']}`, a policy with the hash `{initial['sha256'][:12]}`"
    commit = f"commit `{provenance['git_commit']}`, " if provenance.get("git_commit") else ""
    yield "trained with", f"dockctl {provenance.get('dockctl')}, {commit}{provenance.get('started')}"
    yield "exported with", f"dockctl {dockctl.__version__}, commit `{git_commit()}`"
    own = ", ".join(f"`{name}`" for name in scenario.training.conditions)
    yield "training data", "simulation only" + (f"; {own} from `training.conditions`" if own else "")


def _rate(shares: Mapping[str, float], kind: str) -> str:
    return f"{shares[kind]:.0%}" if kind in shares else "-"


def _part(given: ObservationPart) -> str:
    values = ", ".join(f"{key}={value}" for key, value in given.params.items())
    return f"`{given.part}({values})`" if values else f"`{given.part}`"


def _groups(
    scenario: Scenario, evaluations: Mapping[str, pd.DataFrame]
) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield scenario, kind of start, and the episodes."""
    for stem, episodes in evaluations.items():
        other = stem.removeprefix(EVALUATION).removeprefix("-")
        name = f"another {other}" if other == scenario.name else other or scenario.name
        kinds = START_KINDS if other else OWN_KINDS
        for kind in episodes["start_kind"].unique():
            yield name, kinds.get(kind, kind), episodes[episodes["start_kind"] == kind]


def _successes(groups: Sequence[tuple[str, str, pd.DataFrame]]) -> Iterator[tuple[str, ...]]:
    for name, kind, episodes in groups:
        docked, n = int((episodes["outcome"] == "docked").sum()), len(episodes)
        yield f"`{name}`", kind, *describe_share(docked, n), f"{episodes['clearance_m'].min():.2f} m"


def _map(run: RunDirectory, card: PolicyCard) -> dict[str, str] | None:
    """Return the summary of the success map, if the run has one for this policy."""
    if not is_of_policy(card, run, MAP):
        return None
    starts = _read(run.path / f"{MAP}.csv", CELLS)
    free, limit_m = free_starts(starts), half_width(starts)
    straight, turned = (
        format_radius(success_radius(within_heading(free, limit), limit_m)) for limit in (0, SMALL_OFFSET_DEG)
    )
    return {
        "free": f"{len(free):,}",
        "half_width": f"{limit_m:g}",
        "docked": f"{free['docked'].mean():.0%}",
        "straight": straight,
        "turned": turned,
        "limit": f"{SMALL_OFFSET_DEG:g}",
    }


def envelope_image(run: RunDirectory, card: PolicyCard) -> Path | None:
    """Return the figure of the operating envelope, if the run has one for this policy."""
    image = run.path / FIGURES / f"{ENVELOPE}.png"
    return image if is_of_policy(card, run, ENVELOPE) and image.is_file() else None


def _envelope(run: RunDirectory, card: PolicyCard) -> dict[str, str] | None:
    """Return the facts of the operating envelope, if the run has its figure."""
    if envelope_image(run, card) is None:
        return None
    table = read_table(run.path / f"{ENVELOPE}.csv", ENVELOPE_COLUMNS)
    return None if table is None else {"episodes": f"{table['episodes'].max():,}"}


def _latency(run: RunDirectory, card: PolicyCard) -> dict[str, str] | None:
    """Return the summary of the decision times, if the run has them for this policy."""
    if not is_of_policy(card, run, LATENCY):
        return None
    timing = run.read_json(f"{LATENCY}.json")
    with reading(run.path / f"{LATENCY}.json"):
        times: dict[str, Any] = timing.get("milliseconds") or {}
        if not {"Forward pass", "Whole decision"} <= {*times}:
            return None
        decision = times["Whole decision"]
        return {
            "median": f"{decision['p50']:.2g}",
            "most": f"{decision['max']:.2g}",
            "forward": f"{times['Forward pass']['p50']:.2g}",
            "period": f"{timing['control_period_ms']:g}",
            "processor": str(timing["hardware"]["processor"]),
        }


def _failures(groups: Sequence[tuple[str, str, pd.DataFrame]]) -> Iterator[dict[str, str]]:
    """Yield a summary of the episodes that did not dock: their outcomes and first start poses."""
    for name, kind, episodes in groups:
        failed = episodes[episodes["outcome"] != "docked"]
        if failed.empty:
            continue
        endings = Counter(describe_outcome(row.to_dict()) for _, row in failed.iterrows())
        poses = [pose_label(*pose) for pose in failed[["x_m", "y_m", "heading_deg"]].to_numpy(float)]
        more = f" and {len(poses) - LISTED_FAILURES} more" if len(poses) > LISTED_FAILURES else ""
        yield {
            "scenario": name,
            "starts": kind,
            "count": f"{len(failed)} of {len(episodes):,}",
            "endings": ", ".join(f"{count} {words}" for words, count in count_by_kind(endings).items()),
            "poses": f"{', '.join(poses[:LISTED_FAILURES])}{more}",
        }
