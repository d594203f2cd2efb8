"""Choose a policy among runs, see it dock, and put it into a folder of its own."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from dockctl.agents.checkpoint import save_policy
from dockctl.analysis.episodes import ending
from dockctl.console import say
from dockctl.errors import DockctlError
from dockctl.evaluation.policies import CheckpointPolicy, load_checkpoint
from dockctl.evaluation.rollout import Episode, Rollout
from dockctl.evaluation.starts import TRAINING, training_starts
from dockctl.experiments import model_card
from dockctl.runs.directory import SCENARIO, RunDirectory, require_replaceable
from dockctl.runs.files import new_folder
from dockctl.scenarios.base import NAME
from dockctl.scenarios.content import mesh_files, with_paths
from dockctl.scenarios.interface import PolicyInterface
from dockctl.scenarios.loader import LoadedScenario, dump

CARD = "card.md"
CHECKPOINT = ("policy.json", "policy.safetensors", SCENARIO, CARD)
"""Files of a shipped checkpoint."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """An evaluated run and its policy.

    Attributes:
        evaluation: its ``evaluation.csv``.
        elsewhere: docked share of its other evaluations, elsewhere or with values set, 0 without any.
    """

    trained: CheckpointPolicy
    run: RunDirectory
    evaluation: pd.DataFrame
    elsewhere: float

    @property
    def shares(self) -> dict[str, float]:
        """Docked share of each sort of starts, in the order of the evaluation."""
        docked = self.evaluation["outcome"] == "docked"
        kinds = self.evaluation["start_kind"]
        return {str(kind): float(part.mean()) for kind, part in docked.groupby(kinds, sort=False)}

    @property
    def rank(self) -> tuple[float, float, float, int]:
        """What it is chosen by, the lowest first: success when judged, when tested, elsewhere; the seed."""
        share = self.shares
        judged = share.get("pose", share.get("trained", 0.0))
        tested = share.get("random", share.get("held_out", 0.0))
        return -judged, -tested, -self.elsewhere, self.trained.card.seed


def ship(runs: Sequence[Path], name: str | None, out: Path) -> None:
    """Write the best policy of `runs` to ``<out>/<name>/``: policy, scenario, local files and card.

    Raises:
        DockctlError: a run is not there or not evaluated, the runs differ in their scenario, no policy docks
            from every pose of its training, or the folder cannot be written or
            holds something else.
    """
    candidates = sorted((candidate(path) for path in runs), key=lambda one: one.rank)
    names = sorted({one.trained.card.scenario for one in candidates})
    if len(names) > 1:
        raise DockctlError(f"give runs of one scenario; these are of {', '.join(names)}")
    name = name or names[0]
    if not re.fullmatch(NAME, name):
        raise DockctlError(f"--name '{name}': use letters, digits, dots, dashes and underscores")
    require_replaceable(out / name, CHECKPOINT, ("plugins", "meshes"), "earlier checkpoint")
    for best in candidates:
        loaded = best.trained.scenario()
        episodes = play_training(best.trained, loaded)
        # At many berths the random starts of the evaluation say more than any one pose.
        wanted = [] if loaded.scenario.task.berths else episodes
        failures = [one for one in wanted if not one.docked]
        if not failures:
            folder = write(best, candidates, loaded, episodes, out / name)
            say(Console(), f"{best.run.path} is shipped as {folder}")
            return
        for one in failures:
            x, y, heading = one.start.eta
            say(
                Console(stderr=True),
                f"passed over {best.run.path}: from its training pose {x:g}, {y:g},"
                f" {math.degrees(heading):.4g}°: {ending(one.row())}",
            )
    raise DockctlError("no policy docks from every pose of its training; nothing is shipped")


def candidate(path: Path) -> Candidate:
    """Read a run and its evaluation.

    Raises:
        DockctlError: it is no run, has no policy, or that policy is not evaluated.
    """
    run = RunDirectory.open(path)
    trained = load_checkpoint(path)
    told = f"evaluate it first: dockctl evaluate --ckpt {path}"
    if not (run.path / "evaluation.json").is_file() or not (run.path / "evaluation.csv").is_file():
        raise DockctlError(f"{path}: holds no evaluation; {told}")
    if not model_card.is_of(trained.card, run, "evaluation.json"):
        raise DockctlError(f"{path}: its evaluation is of another policy; {told}")
    tables = model_card.evaluations(run, trained.card)
    others = [one["outcome"] == "docked" for stem, one in tables.items() if stem != "evaluation"]
    elsewhere = float(pd.concat(others).mean()) if others else 0.0
    return Candidate(trained, run, tables["evaluation"], elsewhere)


def play_training(trained: CheckpointPolicy, loaded: LoadedScenario) -> list[Episode]:
    """Play greedy episodes from the poses of the training."""
    rollout = Rollout(loaded)
    starts = training_starts(loaded.scenario, rollout.worlds)
    return rollout.play(trained.make(rollout.env()), starts)


def _table(episodes: Sequence[Episode]) -> pd.DataFrame:
    """Columns `model_card.EPISODES`."""
    starts = [dict(zip(("x_m", "y_m", "heading_rad"), one.start.eta, strict=True)) for one in episodes]
    rows = [
        {"start_kind": TRAINING, **start, **one.row()} for start, one in zip(starts, episodes, strict=True)
    ]
    table = pd.DataFrame(rows)
    return table.assign(heading_deg=np.degrees(table["heading_rad"]))


def write(
    best: Candidate,
    candidates: Sequence[Candidate],
    loaded: LoadedScenario,
    training: Sequence[Episode],
    folder: Path,
) -> Path:
    """Write the folder of a checkpoint, whole, and return it.

    Raises:
        DockctlError: it cannot be written.
    """
    scenario, card = loaded.scenario, best.trained.card
    with new_folder(folder.resolve()) as new:
        interface = card.interface or PolicyInterface.of(scenario)
        save_policy(new, best.trained.network, replace(card, interface=interface))
        home = RunDirectory(new)
        plugins = home.copy_files("plugins", loaded.plugin_files)
        meshes = home.copy_files("meshes", mesh_files(scenario))
        home.write_text(SCENARIO, dump(with_paths(scenario, plugins, meshes)))
        others = [(one.trained.card.seed, one.shares) for one in candidates]
        files = sorted(path for path in new.rglob("*") if path.is_file())
        card = replace(card, interface=interface)
        text = model_card.write(folder.name, scenario, card, best.run, others, _table(training), new, files)
        home.write_text(CARD, text)
    return folder
