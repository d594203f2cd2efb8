"""Export a policy: select the best of several runs, check that it docks, and write its checkpoint folder."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from dockctl.agents.checkpoint import save_policy
from dockctl.analysis.episodes import describe_outcome
from dockctl.console import command_line, print_text
from dockctl.errors import DockctlError
from dockctl.evaluation.loading import load_checkpoint
from dockctl.evaluation.policies import CheckpointPolicy
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.evaluation.starts import TRAINING, training_starts
from dockctl.experiments.model_card import card_text, envelope_image, is_of_policy, read_evaluations
from dockctl.geometry import pose_label
from dockctl.run_files import ENVELOPE, EVALUATION, MESHES, PLUGINS, POLICY_JSON, POLICY_TENSORS, SCENARIO
from dockctl.runs.directory import RunDirectory, shipped
from dockctl.runs.files import new_folder, require_replaceable
from dockctl.scenarios.base import NAME
from dockctl.scenarios.catalog import display_path
from dockctl.scenarios.content import mesh_files, with_paths
from dockctl.scenarios.loader import LoadedScenario, dump
from dockctl.scenarios.schema import PolicyInterface

CARD, IMAGE = "card.md", f"{ENVELOPE}.png"
CHECKPOINT = (POLICY_JSON, POLICY_TENSORS, SCENARIO, CARD)
"""Files of an exported checkpoint."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An evaluated run and its policy.

    Attributes:
        evaluation: its ``evaluation.csv``.
        transfer: success rate of its other evaluations, on other scenarios or with overrides; 0 if none.
    """

    policy: CheckpointPolicy
    run: RunDirectory
    evaluation: pd.DataFrame
    transfer: float

    @property
    def shares(self) -> dict[str, float]:
        """Success rate by kind of start, in the order of the evaluation."""
        docked = self.evaluation["outcome"] == "docked"
        kinds = self.evaluation["start_kind"]
        return {str(kind): float(part.mean()) for kind, part in docked.groupby(kinds, sort=False)}

    @property
    def rank(self) -> tuple[float, float, float, int]:
        """Sort key, best first: success from the poses, in tests, on other scenarios; lowest seed."""
        share = self.shares
        poses = share.get("pose", share.get("trained", 0.0))
        test = share.get("random", share.get("held_out", 0.0))
        return -poses, -test, -self.transfer, self.policy.card.seed


def export_checkpoint(
    runs: Sequence[Path],
    name: str | None,
    out: Path,
    *,
    plugin_files: Sequence[Path] = (),
    trust: bool = False,
) -> None:
    """Write the best policy of `runs` to ``<out>/<name>/``: policy, scenario, local files and model card.

    Args:
        runs: run folders, at least one.
        plugin_files, trust: see `dockctl.evaluation.load_policy`.

    Raises:
        DockctlError: a run does not exist or is not evaluated, the runs have different scenarios, no policy
            docks from all its training poses, or the folder cannot be written or contains something else.
    """
    policies = [load_checkpoint(path, plugin_files=plugin_files, trust=trust) for path in runs]
    candidates = sorted(map(read_candidate, runs, policies), key=lambda candidate: candidate.rank)
    names = sorted({candidate.policy.card.scenario for candidate in candidates})
    if len(names) > 1:
        raise DockctlError(f"the runs must have one scenario; these have {', '.join(names)}", code="mismatch")
    name = name or names[0]
    if not re.fullmatch(NAME, name):
        raise DockctlError(f"--name '{name}': use letters, digits, dots, dashes and underscores")
    require_replaceable(out / name, CHECKPOINT, (PLUGINS, MESHES, IMAGE), "earlier checkpoint")
    for best in candidates:
        loaded = best.policy.scenario()
        episodes = training_episodes(best.policy, loaded)
        # With many berths, the random starts of the evaluation are the better measure.
        required = [] if loaded.scenario.task.berths else episodes
        failures = [episode for episode in required if not episode.docked]
        if not failures:
            folder = write_checkpoint(best, candidates, loaded, episodes, out / name)
            print_text(Console(), f"{display_path(best.run.path)} exported to {folder}")
            if name in shipped():
                note = f"note: the name {name} selects the shipped policy; refer to this one as {folder}"
                print_text(Console(stderr=True), note, "yellow")
            return
        for episode in failures:
            x, y, heading = episode.start.eta
            print_text(
                Console(stderr=True),
                f"skipped {best.run.path}: from its training pose"
                f" {pose_label(x, y, math.degrees(heading))}: {describe_outcome(episode.row())}",
            )
    raise DockctlError("no policy docks from all its training poses; nothing was exported")


def read_candidate(path: Path, policy: CheckpointPolicy) -> Candidate:
    """Read a run and its evaluation.

    Raises:
        DockctlError: it is not a run, has no policy, or this policy is not evaluated.
    """
    run = RunDirectory.open(path)
    command = f"run: {command_line('evaluate', path)}"
    if not all((run.path / f"{EVALUATION}.{suffix}").is_file() for suffix in ("json", "csv")):
        raise DockctlError(f"{path}: is not evaluated; {command}", code="not_found")
    if not is_of_policy(policy.card, run, EVALUATION):
        raise DockctlError(f"{path}: its evaluation is of a different policy; {command}", code="mismatch")
    tables = read_evaluations(run, policy.card)
    others = [table["outcome"] == "docked" for stem, table in tables.items() if stem != EVALUATION]
    transfer = float(pd.concat(others).mean()) if others else 0.0
    return Candidate(policy, run, tables[EVALUATION], transfer)


def training_episodes(policy: CheckpointPolicy, loaded: LoadedScenario) -> list[Episode]:
    """Run greedy episodes from the training poses."""
    rollout = Rollout(loaded)
    starts = training_starts(loaded.scenario, rollout.worlds)
    return rollout.run(policy.make(rollout.env()), starts)


def _table(episodes: Sequence[Episode]) -> pd.DataFrame:
    """Return the columns `model_card.EPISODES` of the episodes."""
    starts = np.array([episode.start.eta for episode in episodes])
    return pd.DataFrame([episode.row() for episode in episodes]).assign(
        start_kind=TRAINING, x_m=starts[:, 0], y_m=starts[:, 1], heading_deg=np.degrees(starts[:, 2])
    )


def write_checkpoint(
    best: Candidate,
    candidates: Sequence[Candidate],
    loaded: LoadedScenario,
    training: Sequence[Episode],
    folder: Path,
) -> Path:
    """Write the checkpoint folder atomically and return it.

    Raises:
        DockctlError: it cannot be written.
    """
    scenario, card = loaded.scenario, best.policy.card
    card = card.model_copy(update={"interface": PolicyInterface.of(scenario)})
    with new_folder(folder.resolve()) as new:
        save_policy(new, best.policy.tensors, card)
        checkpoint = RunDirectory(new)
        plugins = checkpoint.copy_files(PLUGINS, loaded.plugin_files)
        meshes = checkpoint.copy_files(MESHES, mesh_files(scenario))
        checkpoint.write_text(SCENARIO, dump(with_paths(scenario, plugins, meshes)))
        if image := envelope_image(best.run, card):
            shutil.copy(image, new / IMAGE)
        shares = [(candidate.policy.card.seed, candidate.shares) for candidate in candidates]
        paths = sorted(path for path in new.rglob("*") if path.is_file())
        files = {path.relative_to(new).as_posix(): path for path in paths}
        text = card_text(folder.name, scenario, card, best.run, shares, _table(training), files)
        checkpoint.write_text(CARD, text)
    return folder
